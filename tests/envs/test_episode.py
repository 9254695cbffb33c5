"""Whole episodes of every task, as the command line runs them."""

import math
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from laploop.control.controllers.registry import make_controller
from laploop.envs import episode
from laploop.envs.episode import EpisodeConfig, run_episode
from laploop.envs.loop.closed_loop import LoopConfig
from laploop.envs.sensors.optics.presets import PRESETS
from laploop.envs.tasks.registry import TASKS, task_environment
from laploop.envs.theatre.organ_motion import BaseMotion
from laploop.envs.theatre.trocar import TrocarConfig
from laploop.errors import InvalidValueError, MissingFileError, UnknownNameError, WeightsError


@pytest.mark.parametrize("task", TASKS)
def test_every_task_runs_with_its_scripted_controller(task):
    summary = run_episode(EpisodeConfig(task=task, perception="oracle", motion="both", actuation="ur5-e", seed=3, seconds=0.15))
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

    summary = run_episode(EpisodeConfig(task="track", perception="oracle", seconds=0.12), controller=Broken())
    assert summary["fault_ticks"] == {"action_not_finite": 6}


def test_time_and_hold_come_from_the_task_unless_they_are_given():
    assert [EpisodeConfig(task=task).duration_s() for task in TASKS] == [10.0, 20.0, 15.0, 30.0, 10.0]
    assert EpisodeConfig(task="scan", seconds=3.0).duration_s() == 3.0
    assert EpisodeConfig(task="palpate", hold_s=2.0).task_config().success_hold_s == 2.0
    assert EpisodeConfig(task="reach").task_config().success_hold_s == 0.3
    with pytest.raises(InvalidValueError, match="only with the tasks reach and palpate"):
        EpisodeConfig(task="track", hold_s=1.0)
    with pytest.raises(UnknownNameError, match="available: ideal, ur5-cb, ur5-e"):
        EpisodeConfig(actuation="rocket")


def test_tissue_moves_by_default_where_the_task_is_about_motion():
    for task in TASKS:
        config = EpisodeConfig(task=task)
        assert config.task_config().motion == task_environment(task).default_config().motion
        assert config.task_config().motion == BaseMotion.named(config.motion_name())
    assert [EpisodeConfig(task=task).motion_name() for task in ("reach", "track", "look")] == ["still", "both", "breathing"]
    assert EpisodeConfig(task="track", motion="still").motion_name() == "still"


def test_default_optics_latency_and_trocar_are_those_of_the_loop():
    assert EpisodeConfig().task_config().loop == LoopConfig()
    loop = EpisodeConfig(optics="worst", transfer_latency_ns=60_000_000, trocar="none").task_config().loop
    assert (loop.stripes, loop.transfer_ns, loop.trocar) == (PRESETS["worst"], 60_000_000, TrocarConfig.named("none"))
    with pytest.raises(InvalidValueError, match="transfer_latency_ns is -1"):
        EpisodeConfig(transfer_latency_ns=-1)


def test_weights_that_do_not_fit_are_refused_before_anything_is_built(tmp_path):
    with pytest.raises(InvalidValueError, match="'oracle' has nothing to load"):
        run_episode(EpisodeConfig(perception="oracle", weights=tmp_path / "some.safetensors"))
    with pytest.raises(MissingFileError, match="weights not found"):
        run_episode(EpisodeConfig(weights=tmp_path / "none.safetensors"))
    others = files("laploop.assets") / "weights" / "ssle-phase.safetensors"
    with pytest.raises(WeightsError, match="holds weights of"):
        run_episode(EpisodeConfig(weights=Path(str(others))))


def test_given_weights_are_used():
    shipped = Path(str(files("laploop.assets") / "weights" / "compact.safetensors"))
    config = EpisodeConfig(weights=shipped, seconds=0.1)
    assert run_episode(config)["depth_mae_mm"] == run_episode(replace(config, weights=None))["depth_mae_mm"]


def test_prediction_can_be_switched_off(monkeypatch):
    seen = []
    monkeypatch.setattr(episode, "make_controller", lambda *arguments: seen.append(arguments[2]) or make_controller(*arguments))
    for prediction in (None, "none"):
        run_episode(EpisodeConfig(task="track", perception="oracle", prediction=prediction, seconds=0.05))
    assert seen == [None, "none"]


def test_summary_tells_what_the_limits_were_used_to():
    summary = run_episode(EpisodeConfig(perception="oracle", seconds=0.4))
    limits = summary["limits"]
    # The tip sets off in the first 0.4 s, within its limits, far from everything.
    assert 0.0 < limits["joint_speed_share"] < limits["command_speed_share"] <= 1.0
    assert 0.0 < limits["command_acceleration_share"] <= 1.0
    assert limits["shaft_room_mm"] > 10.0
    assert limits["wall_room_mm"] > 10.0
    assert limits["collision_steps"] == 0
    assert summary["port_force_n"]["tool_max"] >= 0.0
