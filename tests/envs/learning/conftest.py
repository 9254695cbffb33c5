from dataclasses import replace

import pytest

from laploop.assets.tissue_config import TissueConfig, TissueShape
from laploop.envs.fidelity import with_fidelity
from laploop.envs.learning.look import LookLearnerEnv
from laploop.envs.learning.palpate import PalpateLearnerEnv
from laploop.envs.learning.reach import ReachLearnerEnv
from laploop.envs.learning.scan import ScanLearnerEnv
from laploop.envs.learning.track import TrackLearnerEnv
from laploop.envs.tasks.registry import default_config

CLASSES = {
    "reach": ReachLearnerEnv,
    "track": TrackLearnerEnv,
    "palpate": PalpateLearnerEnv,
    "scan": ScanLearnerEnv,
    "look": LookLearnerEnv,
}


@pytest.fixture
def learner():
    """Make environments for learners, on coarse tissue with exact depth, that are closed at the end of the test."""
    made = []

    def make(task="reach", changes=None, **keywords):
        config = with_fidelity(default_config(task, **(changes or {})), "fast")
        tissue = TissueConfig(shape=TissueShape(samples=31), cells=(4, 4), contact_every=2)
        loop = replace(config.loop, theatre=replace(config.loop.theatre, tissue=tissue))
        made.append(CLASSES[task](config=replace(config, loop=loop), **{"perception": "oracle", **keywords}))
        return made[-1]

    yield make
    for env in made:
        env.close()
