import ctypes
import gc
import os
import sys
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import pytest

from laploop.assets.tissue_config import TissueConfig, TissueShape
from laploop.control.controllers.registry import make_controller
from laploop.envs.loop.config import LoopConfig
from laploop.envs.tasks.registry import default_config, make_environment
from laploop.envs.theatre.config import TheatreConfig

COARSE = TissueConfig(shape=TissueShape(samples=31), cells=(4, 4))
"""Tissue of a quarter of the vertices and a sixth of the cells: twice as fast, for tests that do not look at it closely."""


def make_coarse(task, **changes):
    """Make the environment of a task on coarse tissue with exact depth; changes may be fields of task, loop or theatre."""
    in_theatre, in_loop = (
        {field.name: changes.pop(field.name) for field in fields(kind) if field.name in changes}
        for kind in (TheatreConfig, LoopConfig)
    )
    config = default_config(task)
    theatre = replace(config.loop.theatre, tissue=COARSE, **in_theatre)
    loop = replace(config.loop, theatre=theatre, **in_loop)
    return make_environment(task, config=replace(config, loop=loop, **changes), perception="oracle")


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


@dataclass(frozen=True)
class Held:
    """What the process holds."""

    memory_mb: float
    threads: int
    descriptors: int

    @classmethod
    def now(cls):
        gc.collect()
        if sys.platform == "linux":
            # What the allocator keeps for later is not held; it comes and goes by per cents.
            ctypes.CDLL(None).malloc_trim(0)
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        process = Path("/proc/self")
        return cls(
            memory_mb=pages * os.sysconf("SC_PAGE_SIZE") * 1e-6,
            threads=len(list((process / "task").iterdir())),
            descriptors=len(list((process / "fd").iterdir())),
        )

    def grew(self, before):
        """Return the relative growth of memory since an earlier look."""
        return self.memory_mb / before.memory_mb - 1.0

    def opened(self, before):
        """Return how many threads and files more there are than at an earlier look."""
        return self.threads - before.threads, self.descriptors - before.descriptors


@pytest.fixture(scope="session")
def held():
    """Look at what the process holds."""
    return Held.now


@pytest.fixture
def returned_memory():
    """Have the allocator give every array back as it is freed; else it keeps some of them, by the chances of threads."""
    if sys.platform != "linux":
        yield
        return
    # Arrays of more than 64 kB are mapped for themselves. glibc's M_MMAP_THRESHOLD, whose default is 128 kB.
    threshold = -3
    ctypes.CDLL(None).mallopt(threshold, 64 * 1024)
    yield
    ctypes.CDLL(None).mallopt(threshold, 128 * 1024)


@pytest.fixture(scope="session")
def coarse_task():
    """Make environments that whoever asks for them closes."""
    return make_coarse


@pytest.fixture
def task_env():
    """Make environments of tasks that are closed at the end of the test."""
    made = []

    def make(task, **changes):
        made.append(make_coarse(task, **changes))
        return made[-1]

    yield make
    for env in made:
        env.close()


@pytest.fixture
def run_task():
    """Play an episode."""
    return play
