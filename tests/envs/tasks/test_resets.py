"""Thousands of episodes in one process: what a reset makes, the next one frees."""

import gc
import os
from dataclasses import dataclass
from pathlib import Path

import pytest


@dataclass(frozen=True)
class Held:
    """What the process holds."""

    memory_mb: float
    threads: int
    descriptors: int

    @classmethod
    def now(cls):
        gc.collect()
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        process = Path("/proc/self")
        return cls(
            memory_mb=pages * os.sysconf("SC_PAGE_SIZE") * 1e-6,
            threads=len(list((process / "task").iterdir())),
            descriptors=len(list((process / "fd").iterdir())),
        )


def held_after(env, *resets, seeds=10):
    """Reset an environment and step it once, again and again; return what is held after so many resets."""
    held = []
    for count in range(1, resets[-1] + 1):
        # The same few theatres, so that memory never grows because a later one is larger.
        env.reset(seed=count % seeds)
        env.step(env.action_space.sample())
        if count in resets:
            held.append(Held.now())
    return held


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seeds", "warm", "resets", "growth"),
    # Theatres that are kept, and more of them than are kept, whose own sizes differ a little.
    [(10, 500, 10_000, 0.02), (1000, 200, 1000, 0.04)],
)
def test_resets_keep_neither_memory_nor_threads_nor_files(task_env, seeds, warm, resets, growth):
    begin, end = held_after(task_env("reach", observation_mode="state"), warm, resets, seeds=seeds)
    assert (end.threads, end.descriptors) == (begin.threads, begin.descriptors)
    assert end.memory_mb <= (1.0 + growth) * begin.memory_mb


def test_a_few_resets_leave_no_thread_and_no_open_file_behind(task_env):
    begin, end = held_after(task_env("reach", observation_mode="state"), 2, 5)
    assert (end.threads, end.descriptors) == (begin.threads, begin.descriptors)
