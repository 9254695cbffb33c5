"""A hundred thousand random steps of the ids for learners: nothing but numbers comes out, and nothing stays behind."""

import numpy as np
import pytest

from laploop.envs.randomisation.files import LEVELS
from laploop.envs.tasks.registry import TASKS
from laploop.envs.theatre import scene
from laploop.envs.theatre.scene_cache import BoundedCache

COUNT = 4
STEPS = {"state": 5_868, "depth": 268, "stripes": 268, "depth+state": 268}
"""Of each task and level, all environments of a vector together; 100 000 over five tasks and three levels."""
HELD = 10
"""Steps for which a random action is held, so that the tip gets somewhere: to tissue, to limits, out of view."""


def assert_numbers(observation):
    parts = observation.values() if isinstance(observation, dict) else [observation]
    assert all(np.isfinite(part).all() for part in parts)


def wander(vector, steps, rng):
    """Step all environments of a vector at random; return how many episodes ended."""
    ended = 0
    actions = None
    for step in range(steps // vector.num_envs):
        if step % HELD == 0:
            actions = rng.uniform(-1.0, 1.0, vector.action_space.shape).astype(np.float32)
        observation, rewards, terminated, truncated, _ = vector.step(actions)
        assert_numbers(observation)
        assert_numbers(rewards)
        ended += int((terminated | truncated).sum())
    assert vector.observation_space.contains(observation)
    return ended


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.usefixtures("returned_memory")
@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("observed", STEPS)
@pytest.mark.parametrize("task", TASKS.names())
def test_random_steps_leave_neither_nan_nor_growing_memory(monkeypatch, held, learner_vector, task, observed, level):
    # Scenes, and tables of optics, are kept up to a number, which differing theatres reach late: few of the one, and short
    # episodes, so that there are many of the other before the first look at what is held.
    monkeypatch.setattr(scene, "_SCENES", BoundedCache(COUNT))
    changes = None if level == "none" else {"max_seconds": 0.52 if observed == "state" else 0.2}
    vector = learner_vector(COUNT, task, observation=observed, randomisation=level, changes=changes)
    rng = np.random.default_rng(0)

    def look():
        # A steeper tissue has a finer mesh, and another scope other tables: memory is compared in the same theatres.
        vector.reset(seed=0)
        return held()

    vector.reset(seed=0)
    wander(vector, STEPS[observed] // 2, rng)
    before = look()
    wander(vector, STEPS[observed] // 2, rng)
    after = look()
    assert after.opened(before) == (0, 0)
    assert after.grew(before) < 0.01


def test_episodes_end_and_begin_again_at_random(learner_vector):
    vector = learner_vector(2, changes={"max_seconds": 0.4})
    vector.reset(seed=0)
    # The first frame takes 0.04 s, each step as much.
    assert wander(vector, 60, np.random.default_rng(0)) >= 4


def test_closed_vectors_leave_no_thread_and_no_open_file_behind(held, learner_vector):
    looks = []
    for _ in range(3):
        vector = learner_vector(2, threads=2)
        vector.reset(seed=0)
        wander(vector, 4, np.random.default_rng(0))
        vector.close()
        looks.append(held())
    # What the first one starts for good serves the later ones.
    assert looks[2].opened(looks[1]) == (0, 0)
