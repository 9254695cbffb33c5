import json

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces

from laploop.errors import InvalidValueError
from laploop.studies.learners.evaluation import (
    RESULT,
    UNSEEN_SEED,
    EpisodeScore,
    Training,
    evaluate,
    summarised,
    verdict,
    write_result,
)


class Corridor(gym.Env):
    """Walk from 3 mm to 0 by steps of the action; seeds that are odd press with 2 N at the first step."""

    observation_space = spaces.Box(-5.0, 5.0, (1,), np.float32)
    action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)

    def reset(self, *, seed=None, options=None):
        self.left, self.count, self.seed = 3.0, 0, seed
        return np.array([self.left], np.float32), {}

    def step(self, action):
        self.left -= float(action[0])
        self.count += 1
        solved = self.left <= 0.0
        info = {
            "is_success": solved,
            "terminated_by": "success" if solved else None,
            "target_error_mm": self.left,
            "contact_force_n": 2.0 if self.seed % 2 and self.count == 1 else 0.5,
        }
        return np.array([self.left], np.float32), 0.25, solved, self.count == 5, info


TRAINING = Training(
    method="sac", environment="laploop/Reach-v1", keywords={"fidelity": "fast"}, seed=1, steps=10, wall_s=2.0, cpu_s=1.0
)


def test_an_episode_is_scored_to_its_end():
    even, odd = evaluate(lambda observation: np.ones(1), Corridor(), 2)
    assert (even.seed, odd.seed) == (UNSEEN_SEED, UNSEEN_SEED + 1)
    assert even.success
    assert even.steps == 3
    assert even.total_return == pytest.approx(0.75)
    assert even.error_mm == 0.0
    assert (even.force_n, odd.force_n) == (0.5, 2.0)


def test_an_episode_that_runs_out_of_time_is_no_success():
    (score,) = evaluate(lambda observation: np.full(1, 0.5), Corridor(), 1)
    assert not score.success
    assert score.steps == 5
    assert score.error_mm == pytest.approx(0.5)


def test_a_policy_with_memory_is_reset_before_each_episode():
    class Impatient:
        """Stands still at first and then speeds up, until `reset` is called."""

        def reset(self):
            self.action = 0.0

        def __call__(self, observation):
            self.action += 1.0
            return np.full(1, self.action - 1.0)

    # 0, 1 and 2 mm add up to the 3 mm; one that went on from the episode before would be there in one step.
    assert [score.steps for score in evaluate(Impatient(), Corridor(), 3)] == [3, 3, 3]


def test_no_episodes_are_refused():
    with pytest.raises(InvalidValueError, match="1 or more"):
        evaluate(lambda observation: np.ones(1), Corridor(), 0)


def scores(successes):
    return [
        EpisodeScore(seed=n, success=s, terminated_by=None, total_return=float(n), steps=10, error_mm=1.0, force_n=0.1)
        for n, s in enumerate(successes)
    ]


def test_rates_have_wilsons_interval_and_means_the_bootstraps():
    found = summarised(scores([True] * 45 + [False] * 5))
    assert found["success_rate"] == pytest.approx(0.9)
    # Wilson, z = 1.96, 45 of 50.
    assert found["success_interval_95"] == pytest.approx((0.7864, 0.9565), abs=1e-3)
    assert found["total_return"]["mean"] == pytest.approx(24.5)
    # Standard error of the mean of 0 to 49: 14.43 / sqrt(50) = 2.04, times 1.96.
    assert found["total_return"]["high"] - found["total_return"]["mean"] == pytest.approx(4.0, abs=0.3)
    assert found["error_mm"] == {"mean": 1.0, "low": 1.0, "high": 1.0}


def test_a_result_says_what_was_trained_and_how_good_it_is(tmp_path):
    result = write_result(tmp_path / "new", TRAINING, scores([True, False]))
    written = json.loads((tmp_path / "new" / RESULT).read_text())
    assert written["method"] == "sac"
    assert written["keywords"] == {"fidelity": "fast"}
    assert [row["success"] for row in written["rows"]] == [True, False]
    assert written["evaluation"]["success_rate"] == 0.5
    assert "success 50 %" in verdict(result)
