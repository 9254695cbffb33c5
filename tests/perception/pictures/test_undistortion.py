import numpy as np
import pytest

from laploop.perception.calibration.results import CameraCalibration
from laploop.perception.geometry import Intrinsics
from laploop.perception.pictures.undistortion import Undistortion
from laploop.perception.reprojection import BrownDistortion

K = Intrinsics(width=256, height=192, fx=230.0, fy=228.0, cx=126.0, cy=99.0)


def camera(distortion):
    return CameraCalibration(
        intrinsics=K, distortion=distortion, view_errors_px=(0.0,) * 5, camera_from_board=np.tile(np.eye(4), (5, 1, 1))
    )


def wave(x, y):
    return 128.0 + 60.0 * np.cos(50.0 * x) + 50.0 * np.sin(40.0 * y)


def test_a_lens_without_distortion_changes_no_bit():
    image = np.random.default_rng(0).integers(0, 256, (192, 256), dtype=np.uint8)
    undistortion = Undistortion(camera(BrownDistortion()))
    assert undistortion.apply(image) is image
    assert undistortion.seen.all()


@pytest.mark.parametrize("k1", [-0.25, 0.2])
def test_a_scene_seen_through_a_lens_becomes_that_of_a_pinhole(k1):
    lens = camera(BrownDistortion(k1=k1, p1=0.003))
    # What the lens shows at a pixel lies on that pixel's undistorted ray.
    rays = lens.undistorted_rays()
    seen = np.round(wave(rays[..., 0], rays[..., 1])).astype(np.uint8)
    undistortion = Undistortion(lens)
    expected = wave(K.rays[..., 0], K.rays[..., 1])
    inside = undistortion.seen[2:-2, 2:-2]
    error = np.abs(undistortion.apply(seen).astype(float) - expected)[2:-2, 2:-2][inside]
    assert error.mean() < 0.7  # grey values: the rounding of both images, 0.25 each, and the interpolation
    assert np.abs(seen - expected).mean() > 10.0


def test_what_the_lens_does_not_reach_is_marked_and_black():
    undistortion = Undistortion(camera(BrownDistortion(k1=0.3)))
    assert 0.5 < undistortion.seen.mean() < 1.0
    image = undistortion.apply(np.full((192, 256), 200, np.uint8))
    assert (image[undistortion.seen] == 200).all()
    assert (image[~undistortion.seen] == 0).all()
    assert not undistortion.seen[0, 0]
