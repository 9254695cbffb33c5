"""Whole episodes of every task, as the command line runs them."""

import math
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from laploop.control.controllers.registry import make_controller
from laploop.envs import episode
from laploop.envs.episode import run_episode
from laploop.envs.episode_config import EpisodeConfig
from laploop.envs.tasks.registry import TASKS
from laploop.errors import InvalidValueError, MissingFileError, WeightsError


@pytest.mark.parametrize("task", TASKS.names())
def test_every_task_runs_with_its_scripted_controller(task):
    summary = run_episode(
        EpisodeConfig.of(task=task, perception="oracle", motion="both", actuation="ur5-e", seed=3, seconds=0.15)
    )
    assert (summary["task"], summary["terminated_by"], summary["actuation"]) == (task, "time", "ur5-e")
    assert math.isfinite(summary["target_error_mm"]["mean"])
    assert summary["fault_ticks"] == {}
    # 0.15 s less the 40 ms until the first depth arrives, in ticks of 8 ms.
    assert sum(summary["status_ticks"].values()) == 14
    assert all(value is None or math.isfinite(value) for value in summary["metrics"].values())


def test_a_users_controller_that_fails_holds_the_arm_and_shows_in_the_summary():
    class Broken:
        def reset(self):
            self.ticks = 0

        def command(self, state):
            self.ticks += 1
            return np.full(3, np.nan) if self.ticks > 4 else np.zeros(3)

    summary = run_episode(EpisodeConfig.of(task="track", perception="oracle", seconds=0.12), controller=Broken())
    assert summary["fault_ticks"] == {"action_not_finite": 6}


def test_weights_that_do_not_fit_are_refused_before_anything_is_built(tmp_path):
    with pytest.raises(InvalidValueError, match=r"names of arguments of estimator oracle is .*'weights'"):
        run_episode(EpisodeConfig.of(perception="oracle", weights=tmp_path / "some.safetensors"))
    with pytest.raises(MissingFileError, match="weights not found"):
        run_episode(EpisodeConfig.of(weights=tmp_path / "none.safetensors"))
    others = files("laploop.assets") / "weights" / "ssle-phase.safetensors"
    with pytest.raises(WeightsError, match="holds weights of"):
        run_episode(EpisodeConfig.of(weights=Path(str(others))))


def test_given_weights_are_used():
    shipped = Path(str(files("laploop.assets") / "weights" / "compact.safetensors"))
    config = EpisodeConfig.of(weights=shipped, seconds=0.1)
    assert run_episode(config)["depth_mae_mm"] == run_episode(config.changed(perception="compact"))["depth_mae_mm"]


def test_prediction_can_be_switched_off(monkeypatch):
    seen = []
    monkeypatch.setattr(
        episode,
        "make_controller",
        lambda *given, prediction, **named: seen.append(prediction) or make_controller(*given, prediction=prediction, **named),
    )
    for prediction in (None, "none"):
        run_episode(EpisodeConfig.of(task="track", perception="oracle", prediction=prediction, seconds=0.05))
    assert seen == [None, "none"]


def test_summary_tells_what_the_limits_were_used_to():
    summary = run_episode(EpisodeConfig.of(perception="oracle", seconds=0.4))
    limits = summary["limits"]
    # The tip sets off in the first 0.4 s, within its limits, far from everything.
    assert 0.0 < limits["joint_speed_share"] < limits["command_speed_share"] <= 1.0
    assert 0.0 < limits["command_acceleration_share"] <= 1.0
    assert limits["shaft_room_mm"] > 10.0
    assert limits["wall_room_mm"] > 10.0
    assert limits["collision_steps"] == 0
    assert summary["port_force_n"]["tool_max"] >= 0.0
