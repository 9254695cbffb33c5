from dataclasses import replace

import gymnasium as gym
import pytest

from laploop.assets.tissue_config import TissueConfig, TissueShape
from laploop.envs.batch.making import make_task_vector
from laploop.envs.fidelity import with_fidelity
from laploop.envs.tasks.registry import default_config, environment_id

COARSE = TissueConfig(shape=TissueShape(samples=31), cells=(4, 4))


def make_config(**changes):
    """Return the reach on coarse tissue, observed as `state`; episodes end after 0.12 s, ten steps after the first frame."""
    config = default_config("reach", **{"observation_mode": "state", "max_seconds": 0.12, **changes})
    return replace(config, loop=replace(config.loop, theatre=replace(config.loop.theatre, tissue=COARSE)))


@pytest.fixture(scope="session")
def coarse_config():
    """Return configurations of short reaches; changes may be fields of the task."""
    return make_config


@pytest.fixture
def vector():
    """Make vectors of short reaches that are closed at the end of the test, in this process unless told otherwise."""
    made = []

    def make(count, **keywords):
        given = {"config": make_config(), "perception": "oracle", "workers": 1} | keywords
        made.append(make_task_vector(num_envs=count, task="reach", **given))
        return made[-1]

    yield make
    for one in made:
        one.close()


@pytest.fixture
def learner_vector():
    """Make vectors of the ids for learners by Gymnasium, on coarse tissues of their own; closed at the end of the test."""
    made = []

    def make(count, task="reach", *, observation="state", changes=None, **keywords):
        config = with_fidelity(default_config(task, **(changes or {})), "fast")
        theatre = replace(config.loop.theatre, tissue=replace(COARSE, contact_every=2))
        # A seed each, so that the theatres stay the same and targets change.
        theatres = [replace(theatre, seed=number) for number in range(count)]
        own = [{"config": replace(config, loop=replace(config.loop, theatre=one))} for one in theatres]
        given = {"workers": 1, "perception": "oracle", "observation": observation} | keywords
        name = environment_id(task, 1)
        made.append(gym.make_vec(name, num_envs=count, vectorization_mode="vector_entry_point", each=own, **given))
        return made[-1]

    yield make
    for one in made:
        one.close()
