"""A camera that shares its buffers sees what one of its own sees."""

from dataclasses import replace

import numpy as np
import pytest

from laploop.assets.tissue_config import TissueConfig, TissueShape
from laploop.envs.sensors.optics.exposure_control import ExposureControl
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.envs.sensors.shared_stripe_camera import SharedStripeCamera
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.envs.theatre.config import TheatreConfig
from laploop.envs.theatre.theatre import Theatre
from laploop.errors import InvalidValueError
from laploop.perception.geometry import Rig

CONFIG = TheatreConfig(tissue=TissueConfig(shape=TissueShape(samples=31), cells=(4, 4)))
OPTICS = (StripeOptics(), replace(StripeOptics(), exposure_s=0.002, exposure_control=ExposureControl(gain=0.5)))


@pytest.fixture(scope="module")
def theatres():
    return [Theatre(CONFIG, seed=seed) for seed in (0, 1)]


def looked(camera, theatre):
    camera.attach(theatre.model, tissue=theatre.tissue, rng=np.random.default_rng(0))
    return camera


def views(camera, theatre, number):
    snapshot = camera.snapshot(theatre.data, theatre.world_from_camera())
    exact = camera.exact_view(snapshot)
    image = camera.render(snapshot, np.random.default_rng(number)).image
    return camera.depth_view(snapshot).depth_mm, exact.depth_mm, exact.lit, image


def test_two_scenes_in_turns_look_as_through_a_camera_each(theatres):
    rig = Rig.from_optics(CONFIG.scope)
    shared = [looked(SharedStripeCamera(CONFIG.scope, optics), one) for optics, one in zip(OPTICS, theatres, strict=True)]
    own = [looked(StripeCamera(rig, optics, threads=1), one) for optics, one in zip(OPTICS, theatres, strict=True)]
    assert shared[0]._buffers is shared[1]._buffers
    for number in range(2):
        for mine, theirs, theatre in zip(shared, own, theatres, strict=True):
            for seen, expected in zip(views(mine, theatre, number), views(theirs, theatre, number), strict=True):
                np.testing.assert_array_equal(seen, expected)
            assert mine.optics == theirs.optics
            for _ in range(10):
                theatre.step()
    # Exposure control has changed that of the second alone.
    assert shared[0].optics == OPTICS[0]
    assert shared[1].optics != OPTICS[1]


def test_nothing_is_seen_before_a_scene_is_attached():
    camera = SharedStripeCamera(CONFIG.scope, StripeOptics())
    with pytest.raises(InvalidValueError, match="a scene that was attached"):
        camera.snapshot(None, np.eye(4))
