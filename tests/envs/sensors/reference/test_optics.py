import json
from dataclasses import replace

import numpy as np
import pytest

from laploop.configuration import from_plain, to_plain
from laploop.envs.sensors.reference.optics import ReferenceOptics
from laploop.errors import InvalidValueError

WHOLE = ReferenceOptics(sampling="4x4")
REGION = (201, 150, 220, 160)
COLUMN, ROW, WIDTH, HEIGHT = REGION
CROP = (slice(ROW, ROW + HEIGHT), slice(COLUMN, COLUMN + WIDTH))


def test_numbers_are_those_of_the_data_sheet():
    optics = ReferenceOptics(sampling="full")
    camera = optics.intrinsics
    assert (camera.width, camera.height, camera.fx, camera.cx, camera.cy) == (2448, 2048, 2481.0, 1224.0, 1024.0)
    projector_from_camera = optics.rig.projector_from_camera
    centre = -projector_from_camera[:3, :3].T @ projector_from_camera[:3, 3]
    np.testing.assert_allclose(centre, [0.1112, 0.0, 0.0079], atol=1e-12)
    # The projector's axis leans to the camera's, 4.87 degrees.
    axis = optics.rig.projector_from_camera[2, :3]
    assert np.degrees(np.arctan2(-axis[0], axis[2])) == pytest.approx(4.87, abs=0.01)
    # Sampling keeps the field of view and the middle of the image.
    for sampling, step in (("2x2", 2), ("4x4", 4)):
        sampled = replace(optics, sampling=sampling).intrinsics
        assert (sampled.width, sampled.height) == (2448 // step, 2048 // step)
        corners = [k.unproject(np.array([0.0, k.height]), 1.0) for k in (camera, sampled)]
        np.testing.assert_allclose(corners[0], corners[1], atol=1e-12)


def test_converging_rig_triangulates_what_it_projects():
    rig = WHOLE.rig
    depth = 0.3 + 0.8 * np.random.default_rng(0).random((512, 612))
    np.testing.assert_allclose(rig.depth_from_projector_x(rig.projector_x(depth)), depth, rtol=1e-9)


def test_region_from_json_is_the_same_camera():
    optics = replace(WHOLE, region=REGION)
    assert from_plain(ReferenceOptics, json.loads(json.dumps(to_plain(optics)))) == optics


@pytest.mark.parametrize("region", [(-1, 0, 32, 32), (0, 0, 8, 32), (600, 0, 32, 32), (0, 500, 32, 32), (0, 0, 32)])
def test_region_outside_the_image_is_refused(region):
    with pytest.raises(InvalidValueError, match="region"):
        replace(WHOLE, region=region)


@pytest.mark.parametrize("seed", [-1, 1.5, True, "1", 2**32])
def test_seeds_of_a_camera_are_integers_from_zero(seed):
    with pytest.raises(InvalidValueError, match=r"unit_seed is .*; allowed: an integer, at least 0, below 4294967296"):
        replace(WHOLE, unit_seed=seed)
