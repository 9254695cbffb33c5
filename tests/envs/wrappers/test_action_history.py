"""The last actions, and the age of depth, in what is observed."""

import numpy as np
import pytest

from laploop.envs.tasks.observations import MAX_AGE_S
from laploop.envs.wrappers.action_history import ActionHistory
from laploop.errors import InvalidValueError


def test_a_vector_is_followed_by_the_last_actions_within_their_bounds_and_the_age_of_depth(decisions):
    env = ActionHistory(decisions(), 2)
    observation, info = env.reset(seed=3)
    np.testing.assert_array_equal(observation[6:12], np.zeros(6))
    assert observation[12] == pytest.approx(info["depth_age_ms"] * 1e-3) == pytest.approx(0.04)
    for action in ([0.1, 0.2, 0.3], [-0.4, 5.0, 0.0], [0.5, 0.5, np.float32(-0.25)]):
        observation, *_, info = env.step(np.array(action, np.float32))
    np.testing.assert_allclose(observation[6:12], [-0.4, 1.0, 0.0, 0.5, 0.5, -0.25], rtol=1e-6)
    assert observation[12] == pytest.approx(info["depth_age_ms"] * 1e-3)
    assert env.observation_space.contains(observation)
    assert env.observation_space.high[12] == MAX_AGE_S


def test_a_dictionary_gets_an_entry_for_actions_and_one_for_the_age_unless_it_has_that(task_env):
    truth = ActionHistory(task_env("reach", observation_mode="state"), 3)
    observation, _ = truth.reset(seed=3)
    assert observation["past_actions"].shape == (3, 3)
    np.testing.assert_allclose(observation["depth_age_s"], [0.04])
    assert truth.observation_space.contains(observation)
    seen = task_env("reach", observation_mode="depth")
    assert ActionHistory(seen).observation_space["depth_age_s"] == seen.observation_space["depth_age_s"]


@pytest.mark.parametrize("k", [0, 1001, 2.0])
def test_an_impossible_number_of_actions_is_refused(decisions, k):
    with pytest.raises(InvalidValueError, match=r"k is .*an integer, 1 to 1000"):
        ActionHistory(decisions(), k)
