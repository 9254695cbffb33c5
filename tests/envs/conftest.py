from dataclasses import replace

import numpy as np
import pytest

from laploop.assets.tissue_config import TissueConfig, TissueShape
from laploop.control.controllers.registry import make_controller
from laploop.envs.tasks.registry import task_environment

COARSE = TissueConfig(shape=TissueShape(samples=31), cells=(4, 4))
"""Tissue of a quarter of the vertices and a sixth of the cells: twice as fast, for tests that do not look at it closely."""


def coarse_task(task, **changes):
    """Make the environment of a task on coarse tissue with exact depth."""
    environment = task_environment(task)
    config = replace(environment.default_config(), tissue=COARSE, **changes)
    return environment(config, perception="oracle")


def play(env, *, seed, controller=None, watch=None):
    """Run an episode with the scripted controller of its task, or another; return the infos of all ticks."""
    controller = controller or make_controller(env.task, env.loop.rig)
    controller.reset()
    env.reset(seed=seed)
    infos = []
    finished = False
    while not finished:
        action = np.asarray(controller.command(env.control_input()), np.float32)
        _, _, terminated, truncated, info = env.step(action)
        infos.append(info)
        if watch is not None:
            watch(env)
        finished = terminated or truncated
    return infos


@pytest.fixture
def task_env():
    """Make environments of tasks that are closed at the end of the test."""
    made = []

    def make(task, **changes):
        made.append(coarse_task(task, **changes))
        return made[-1]

    yield make
    for env in made:
        env.close()


@pytest.fixture
def run_task():
    """Play an episode."""
    return play
