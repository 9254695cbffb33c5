from dataclasses import replace

import pytest

from laploop.assets.tissue_config import TissueConfig, TissueShape
from laploop.envs.batch.making import make_task_vector
from laploop.envs.tasks.registry import default_config

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
