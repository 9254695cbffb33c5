import threading
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces

from laploop.assets.tissue_config import TissueConfig, TissueShape
from laploop.envs.fidelity import with_fidelity
from laploop.envs.tasks.registry import default_config, environment_id


class Decisions(gym.Env):
    """An environment around a task's, not one of Gymnasium's wrappers: five control periods a step, observations of its own."""

    def __init__(self, task_env, image=None):
        self.task_env = task_env
        self.image = image
        self.view = threading.Lock()
        self.action_space = spaces.Box(-1.0, 1.0, (3,), np.float32)
        vector = spaces.Box(-5.0, 5.0, (6,), np.float32)
        picture = spaces.Box(0, 255, (256, 256, 1), np.uint8)
        self.observation_space = vector if image is None else spaces.Dict({image: picture, "proprioception": vector})

    def __getstate__(self):
        # What cannot be pickled is made anew when it is needed.
        return vars(self) | {"view": None}

    def reset(self, *, seed=None, options=None):
        observation, info = self.task_env.reset(seed=seed, options=options)
        super().reset(seed=seed)
        return self._observed(observation), info

    def step(self, action):
        total = 0.0
        for _ in range(5):
            observation, reward, terminated, truncated, info = self.task_env.step(0.06 * action)
            total += reward
            if terminated or truncated:
                break
        return self._observed(observation), total, terminated, truncated, info

    def close(self):
        self.task_env.close()

    def _observed(self, observation):
        vector = np.concatenate([observation["tip_position"], observation["tip_velocity"]])
        if self.image is None:
            return vector
        picture = observation["stripes"] if self.image == "stripes" else observation["depth_mm"].astype(np.uint8)
        return {self.image: picture[..., None], "proprioception": vector}


@pytest.fixture
def decisions(task_env):
    """Make an environment of decisions around a task's."""

    def make(task="reach", image=None, **changes):
        return Decisions(task_env(task, observation_mode=image or "state", **changes), image)

    return make


@pytest.fixture
def randomised():
    """Make environments whose episodes differ by Gymnasium, on coarse tissue with exact depth, that are closed at the end."""
    made = []

    def make(observation="state", task="reach", randomisation="wide"):
        config = with_fidelity(default_config(task), "fast")
        tissue = TissueConfig(shape=TissueShape(samples=31), cells=(4, 4), contact_every=2)
        loop = replace(config.loop, theatre=replace(config.loop.theatre, tissue=tissue))
        keywords = {"config": replace(config, loop=loop), "perception": "oracle", "randomisation": randomisation}
        made.append(gym.make(environment_id(task, 1), observation=observation, **keywords))
        return made[-1]

    yield make
    for env in made:
        env.close()
