"""The checkers of Gymnasium and stable-baselines3 on vectors; every warning is an error, as in all tests."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.utils.passive_env_checker import check_action_space, check_obs, check_observation_space

OBSERVATIONS = ("state", "depth+state")


def first(values):
    """Return what the first environment of a vector observes."""
    return {key: value[0] for key, value in values.items()} if isinstance(values, dict) else values[0]


class OnlyOne(gym.Env):
    """A vector of one environment as that environment, for the checkers, which know no vectors."""

    def __init__(self, vector):
        self.vector = vector
        self.observation_space, self.action_space = vector.single_observation_space, vector.single_action_space

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        observations, infos = self.vector.reset(seed=seed, options=options)
        return first(observations), {key: values[0] for key, values in infos.items() if isinstance(values, np.ndarray)}

    def step(self, action):
        observations, rewards, terminated, truncated, _ = self.vector.step(np.asarray(action)[None])
        return first(observations), float(rewards[0]), bool(terminated[0]), bool(truncated[0]), {}


@pytest.mark.parametrize("observed", OBSERVATIONS)
def test_gymnasiums_checks_of_spaces_pass_on_batches(learner_vector, observed):
    vector = learner_vector(2, observation=observed)
    check_observation_space(vector.observation_space)
    check_action_space(vector.action_space)
    check_obs(vector.reset(seed=0)[0], vector.observation_space, "reset")
    vector.action_space.seed(0)
    check_obs(vector.step(vector.action_space.sample())[0], vector.observation_space, "step")


@pytest.mark.parametrize("observed", OBSERVATIONS)
def test_both_checkers_pass_on_a_vector_of_one(learner_vector, observed):
    stable = pytest.importorskip("stable_baselines3.common.env_checker")
    env = OnlyOne(learner_vector(1, observation=observed, autoreset_mode="DISABLED"))
    check_env(env, skip_render_check=True)
    stable.check_env(env, warn=True)
