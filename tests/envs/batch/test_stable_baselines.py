"""stable-baselines3 learns from a vector behind its own interface, which it checks for what is not a number."""

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecCheckNan, VecEnv, VecMonitor


class AsStable(VecEnv):
    """A vector behind the interface of stable-baselines3."""

    def __init__(self, vector):
        self.vector = vector
        super().__init__(vector.num_envs, vector.single_observation_space, vector.single_action_space)

    def reset(self):
        return self.vector.reset()[0]

    def step_async(self, actions):
        self.actions = actions

    def step_wait(self):
        observations, rewards, terminated, truncated, infos = self.vector.step(self.actions)
        told = [{"TimeLimit.truncated": bool(late and not over)} for over, late in zip(terminated, truncated, strict=True)]
        for number in np.flatnonzero(terminated | truncated):
            told[number]["terminal_observation"] = infos["final_obs"][number]
        return observations, rewards, terminated | truncated, told

    def close(self):
        self.vector.close()

    def get_attr(self, attr_name, indices=None):
        return list(self.vector.get_attr(attr_name))

    def set_attr(self, attr_name, value, indices=None):
        self.vector.set_attr(attr_name, value)

    def env_method(self, method_name, *method_args, indices=None, **method_kwargs):
        return list(self.vector.call(method_name, *method_args, **method_kwargs))

    def env_is_wrapped(self, wrapper_class, indices=None):
        return [False] * self.num_envs


@pytest.mark.parametrize(("observed", "policy"), [("state", "MlpPolicy"), ("depth+state", "MultiInputPolicy")])
def test_stable_baselines_learns_from_a_vector_without_nan(learner_vector, observed, policy):
    vector = learner_vector(2, observation=observed, changes={"max_seconds": 0.4}, autoreset_mode="SAME_STEP")
    checked = VecMonitor(VecCheckNan(AsStable(vector), raise_exception=True, warn_once=False))
    learner = PPO(policy, checked, n_steps=16, batch_size=16, n_epochs=1, seed=0, device="cpu").learn(32)
    # Episodes last nine or ten steps.
    assert len(learner.ep_info_buffer) == 2
