import numpy as np
import pytest

from laploop.control.targeting.sample_depth import sample_depth
from laploop.perception.messages import DepthEstimate, DepthFrame


def frame_of(depth_m, valid):
    estimate = DepthEstimate(depth_mm=(1e3 * depth_m).astype(np.float32), valid=valid)
    return DepthFrame(index=0, captured_ns=0, available_ns=0, world_from_camera=np.eye(4), estimate=estimate)


@pytest.fixture
def slope(rig):
    camera = rig.camera
    rows, columns = np.mgrid[: camera.height, : camera.width]
    return 0.08 + 1e-5 * columns + 2e-5 * rows


def points_at(rig, pixels, depth_m=0.09):
    return rig.camera.unproject(pixels, depth_m)


def test_depth_between_pixel_centres_is_bilinear(rig, slope):
    pixels = np.random.default_rng(0).uniform(1.0, 250.0, (50, 2))
    depth, seen = sample_depth(frame_of(slope, np.ones(slope.shape, dtype=bool)), rig.camera, points_at(rig, pixels))
    assert seen.all()
    expected = 0.08 + 1e-5 * (pixels[:, 0] - 0.5) + 2e-5 * (pixels[:, 1] - 0.5)
    np.testing.assert_allclose(depth, expected, atol=1e-8)  # metres, of depth in single precision


@pytest.mark.parametrize("spoilt", [np.nan, np.inf])
def test_one_bad_neighbour_of_four_is_enough_to_know_nothing(rig, slope, spoilt):
    valid = np.ones(slope.shape, dtype=bool)
    valid[100, 100] = False
    slope[50, 50] = spoilt
    pixels = np.array([[100.7, 100.7], [100.3, 100.3], [101.7, 100.7], [50.2, 50.9], [49.9, 49.9], [52.0, 50.5]])
    _, seen = sample_depth(frame_of(slope, valid), rig.camera, points_at(rig, pixels))
    np.testing.assert_array_equal(seen, [False, False, True, False, False, True])


def test_points_outside_of_the_frame_are_not_seen(rig, slope):
    camera = rig.camera
    pixels = np.array([[-3.0, 50.0], [0.4, 50.0], [0.6, 50.0], [50.0, camera.height - 0.4], [1e6, -1e6]])
    _, seen = sample_depth(frame_of(slope, np.ones(slope.shape, dtype=bool)), rig.camera, points_at(rig, pixels))
    np.testing.assert_array_equal(seen, [False, False, True, False, False])
