"""Thousands of episodes in one process: what a reset makes, the next one frees."""

import pytest


def held_after(held, env, *resets, seeds=10):
    """Reset an environment and step it once, again and again; return what is held after so many resets."""
    looks = []
    for count in range(1, resets[-1] + 1):
        # The same few theatres, so that memory never grows because a later one is larger.
        env.reset(seed=count % seeds)
        env.step(env.action_space.sample())
        if count in resets:
            looks.append(held())
    return looks


@pytest.mark.slow
@pytest.mark.parametrize(
    ("task", "seeds", "warm", "resets", "growth"),
    # Theatres that are kept, and more of them than are kept, whose own sizes differ a little.
    [("reach", 10, 500, 10_000, 0.01), ("track", 10, 500, 5000, 0.01), ("reach", 1000, 200, 1000, 0.04)],
)
def test_resets_keep_neither_memory_nor_threads_nor_files(held, task_env, task, seeds, warm, resets, growth):
    begin, end = held_after(held, task_env(task, observation_mode="state"), warm, resets, seeds=seeds)
    assert end.opened(begin) == (0, 0)
    assert end.grew(begin) <= growth


def test_a_few_resets_leave_no_thread_and_no_open_file_behind(held, task_env):
    begin, end = held_after(held, task_env("reach", observation_mode="state"), 2, 5)
    assert end.opened(begin) == (0, 0)
