"""Whole episodes of every task, as the command line runs them."""

import math

import numpy as np
import pytest

from laploop.envs.episode import EpisodeConfig, run_episode
from laploop.envs.tasks import TASKS
from laploop.errors import InvalidValueError, UnknownNameError


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
