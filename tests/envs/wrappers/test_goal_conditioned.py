"""Goals that are reached, and goals that should be."""

import numpy as np
import pytest

from laploop.envs.wrappers.goal_conditioned import GoalConditioned
from laploop.errors import InvalidValueError

STILL = np.zeros(3, np.float32)


def test_goals_are_the_tip_and_its_place_on_the_target_and_their_distance_is_the_target_error(task_env):
    env = GoalConditioned(task_env("reach", observation_mode="state"))
    observation, info = env.reset(seed=3)
    assert env.observation_space.contains(observation)
    apart_mm = 1e3 * np.linalg.norm(observation["achieved_goal"] - observation["desired_goal"])
    assert apart_mm == pytest.approx(info["target_error_mm"], abs=1e-4)
    assert not info["is_success"]
    _, reward, *_ = env.step(STILL)
    assert reward == -1.0


def test_rewards_are_computed_for_many_goals_at_once_as_for_one(task_env):
    env, dense = (GoalConditioned(task_env("reach", observation_mode="state"), reward) for reward in ("sparse", "dense"))
    desired = np.zeros((4, 2, 3))
    achieved = desired + np.linspace(0.0, 0.003, 8).reshape(4, 2, 1) * [1.0, 0.0, 0.0]
    sparse = env.compute_reward(achieved, desired, [{}] * 8)
    # The success radius is 1.5 mm.
    np.testing.assert_array_equal(sparse.ravel(), [0, 0, 0, 0, -1, -1, -1, -1])
    np.testing.assert_allclose(dense.compute_reward(achieved, desired, None).ravel(), -np.linspace(0.0, 0.003, 8), atol=1e-9)
    assert env.compute_reward(achieved[3, 1], desired[3, 1], {}) == -1.0


def test_images_scopes_and_missing_thresholds_are_refused(task_env):
    with pytest.raises(InvalidValueError, match="observation space of GoalConditioned"):
        GoalConditioned(task_env("reach", observation_mode="depth"))
    with pytest.raises(InvalidValueError, match="a task that moves the tool"):
        GoalConditioned(task_env("look", observation_mode="state"))
    with pytest.raises(InvalidValueError, match="distance_threshold_m is None"):
        GoalConditioned(task_env("track", observation_mode="state"))
    assert GoalConditioned(task_env("track", observation_mode="state"), distance_threshold_m=0.01).distance_threshold_m == 0.01
