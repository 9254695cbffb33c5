"""The camera on the flange, from corners in closed form."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from laploop.assets.calibration_board import CalibrationBoard
from laploop.errors import InvalidValueError
from laploop.perception.calibration.hand_eye import calibrate_hand_eye, solve_ax_xb
from laploop.perception.calibration.results import CameraCalibration, transform_residual
from laploop.perception.geometry import Intrinsics, invert_transform, transform_points
from laploop.perception.reprojection import BrownDistortion

BOARD = CalibrationBoard()
CAMERA = CameraCalibration(
    intrinsics=Intrinsics(width=256, height=256, fx=222.0, fy=222.0, cx=128.0, cy=128.0),
    distortion=BrownDistortion(k1=-0.1),
    view_errors_px=(0.0,) * 5,
    camera_from_board=np.tile(np.eye(4), (5, 1, 1)),
)


def pose(angles_deg, shift_m):
    transform = np.eye(4)
    transform[:3, :3] = Rotation.from_euler("xyz", angles_deg, degrees=True).as_matrix()
    transform[:3, 3] = shift_m
    return transform


FLANGE_FROM_CAMERA = pose((1.0, -2.0, 40.0), (-0.0025, 0.001, 0.42))
WORLD_FROM_BOARD = pose((178.0, 3.0, 20.0), (0.03, -0.02, 0.1))


def scene(count, seed=1, axis_only=False):
    rng = np.random.default_rng(seed)
    flanges, cameras = [], []
    for _ in range(count):
        tilt = np.zeros(2) if axis_only else rng.uniform(-25.0, 25.0, 2)
        camera_from_board = pose((*tilt, rng.uniform(-60.0, 60.0)), np.zeros(3))
        camera_from_board[:3, 3] = [0.0, 0.0, rng.uniform(0.08, 0.12)] - camera_from_board[:3, :3] @ BOARD.centre
        cameras.append(camera_from_board)
        flanges.append(WORLD_FROM_BOARD @ invert_transform(camera_from_board) @ invert_transform(FLANGE_FROM_CAMERA))
    return flanges, cameras


def corners(cameras, noise_px=0.0):
    rng = np.random.default_rng(3)
    exact = [CAMERA.project(transform_points(transform, BOARD.corners)) for transform in cameras]
    return [view + noise_px * rng.standard_normal(view.shape) for view in exact]


def test_closed_form_is_exact_for_exact_poses():
    np.testing.assert_allclose(solve_ax_xb(*scene(6)), FLANGE_FROM_CAMERA, atol=1e-9)


def test_exact_corners_give_camera_and_board():
    flanges, cameras = scene(8)
    found = calibrate_hand_eye(flanges, corners(cameras), BOARD, CAMERA)
    np.testing.assert_allclose(found.flange_from_camera, FLANGE_FROM_CAMERA, atol=1e-6)
    np.testing.assert_allclose(found.world_from_board, WORLD_FROM_BOARD, atol=1e-6)
    assert found.error_px < 1e-3


def test_refinement_on_corners_beats_the_closed_form():
    flanges, cameras = scene(20)
    noisy = corners(cameras, 0.08)
    found = calibrate_hand_eye(flanges, noisy, BOARD, CAMERA)
    degrees, mm = transform_residual(found.flange_from_camera, FLANGE_FROM_CAMERA)
    # 840 corners of 0.08 px at 0.1 m are good for hundredths of a degree and tenths of a millimetre.
    assert degrees < 0.03
    assert mm < 0.15
    assert found.error_px == pytest.approx(0.08 * np.sqrt(2.0), rel=0.1)


def test_turns_about_one_axis_alone_are_refused():
    flanges, cameras = scene(8, axis_only=True)
    with pytest.raises(InvalidValueError, match="tilt the camera to all sides"):
        calibrate_hand_eye(flanges, corners(cameras), BOARD, CAMERA)


def test_too_few_or_unpaired_views_are_refused():
    flanges, cameras = scene(6)
    with pytest.raises(InvalidValueError, match="number of views is 4; allowed: at least 5"):
        calibrate_hand_eye(flanges[:4], corners(cameras[:4]), BOARD, CAMERA)
    with pytest.raises(InvalidValueError, match="flange's poses is 5; allowed: 6"):
        calibrate_hand_eye(flanges[:5], corners(cameras), BOARD, CAMERA)
