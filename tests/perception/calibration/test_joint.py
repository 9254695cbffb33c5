"""The joint adjustment of two cameras, on corners in closed form."""

import os
import subprocess
import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from laploop.assets.calibration_board import CalibrationBoard
from laploop.errors import InvalidValueError
from laploop.perception.calibration.joint import calibrate_jointly
from laploop.perception.calibration.poses import place_board, pose_as_vector, vectors_as_poses
from laploop.perception.calibration.results import CameraCalibration, transform_residual
from laploop.perception.calibration.solve import calibrate_camera
from laploop.perception.geometry import Intrinsics, invert_transform, transform_points
from laploop.perception.reprojection import BrownDistortion

BOARD = CalibrationBoard()
SCOPE = Intrinsics(width=256, height=256, fx=223.1, fy=219.4, cx=130.3, cy=126.2)
REFERENCE = Intrinsics(width=2448, height=2048, fx=2481.0, fy=2482.0, cx=1224.0, cy=1020.0)


def pose(angles_deg, shift_m):
    transform = np.eye(4)
    transform[:3, :3] = Rotation.from_euler("xyz", angles_deg, degrees=True).as_matrix()
    transform[:3, 3] = shift_m
    return transform


SCOPE_FROM_REFERENCE = pose((35.0, 2.0, -3.0), (0.01, 0.34, -0.4))


def camera(intrinsics, distortion=None):
    return CameraCalibration(
        intrinsics=intrinsics,
        distortion=distortion or BrownDistortion(),
        view_errors_px=(0.0,) * 5,
        camera_from_board=np.tile(np.eye(4), (5, 1, 1)),
    )


def board_poses(count, seed):
    rng = np.random.default_rng(seed)
    poses = []
    for _ in range(count):
        transform = pose(rng.uniform(-30.0, 30.0, 3), np.zeros(3))
        middle = [*rng.uniform(-0.01, 0.01, 2), rng.uniform(0.07, 0.13)]
        transform[:3, 3] = middle - transform[:3, :3] @ BOARD.centre
        poses.append(transform)
    return poses


def views(model, poses, noise_px=0.0, rng=None):
    exact = [model.project(transform_points(transform, BOARD.corners)) for transform in poses]
    return [view + (rng.normal(0.0, noise_px, view.shape) if noise_px else 0.0) for view in exact]


def calibrate(noise_px, distortion=None, count=12, seed=0):
    rng = np.random.default_rng(seed)
    scope, reference = camera(SCOPE, distortion), camera(REFERENCE)
    own, pairs = board_poses(count, 10 + seed), board_poses(count, 50 + seed)
    own_views, in_scope = (views(scope, poses, noise_px, rng) for poses in (own, pairs))
    in_reference = views(reference, [invert_transform(SCOPE_FROM_REFERENCE) @ p for p in pairs], noise_px / 3.0, rng)
    start = calibrate_camera(own_views, BOARD, width=256, height=256)
    return calibrate_jointly(own_views, in_scope, in_reference, BOARD, scope=start, reference=reference), pairs


@pytest.mark.parametrize("distortion", [BrownDistortion(), BrownDistortion(k1=-0.2, k2=0.05, p1=0.001, p2=-0.002)])
def test_exact_corners_give_exact_intrinsics_and_transform(distortion):
    found, pairs = calibrate(0.0, distortion)
    scope = found.stereo.scope
    for name in ("fx", "fy", "cx", "cy"):
        # The start took corners as 32-bit floats; the adjustment takes them as they are.
        assert getattr(scope.intrinsics, name) == pytest.approx(getattr(SCOPE, name), rel=1e-6)
    for name in ("k1", "k2", "p1", "p2"):
        assert getattr(scope.distortion, name) == pytest.approx(getattr(distortion, name), abs=1e-5)
    degrees, mm = transform_residual(found.stereo.scope_from_reference, SCOPE_FROM_REFERENCE)
    assert degrees < 1e-5
    assert mm < 1e-3
    np.testing.assert_allclose(found.scope_from_board, pairs, atol=1e-6)
    assert found.scope_error_px < 1e-4
    assert found.reference_error_px < 1e-4


def test_noisy_corners_give_the_transform_and_their_own_noise():
    found, _ = calibrate(0.055, count=20)
    degrees, mm = transform_residual(found.stereo.scope_from_reference, SCOPE_FROM_REFERENCE)
    # Twenty views of 42 corners, all near the middle of the picture; the second camera is 0.53 m away.
    assert degrees < 0.1
    assert mm < 0.5
    # Two coordinates a corner; the fit takes a few percent.
    assert found.scope_error_px == pytest.approx(0.055 * np.sqrt(2.0), rel=0.1)
    assert found.reference_error_px == pytest.approx(0.055 / 3.0 * np.sqrt(2.0), rel=0.15)
    assert found.stereo.reference.intrinsics == REFERENCE
    assert len(found.stereo.view_errors_px) == 20


def test_own_views_must_be_those_of_the_camera():
    scope, reference = camera(SCOPE), camera(REFERENCE)
    seen = views(scope, board_poses(6, 1))
    with pytest.raises(InvalidValueError, match="own views is 6; allowed: 5"):
        calibrate_jointly(seen, seen, seen, BOARD, scope=scope, reference=reference)


def test_views_must_come_in_pairs_and_show_all_corners():
    scope, reference = camera(SCOPE), camera(REFERENCE)
    seen = views(scope, board_poses(5, 1))
    with pytest.raises(InvalidValueError, match="reference camera's views is 4; allowed: 5"):
        calibrate_jointly(seen, seen, seen[:4], BOARD, scope=scope, reference=reference)
    with pytest.raises(InvalidValueError, match=r"\(41, 2\); allowed: \(42, 2\)"):
        calibrate_jointly(seen, seen, [*seen[:4], seen[4][1:]], BOARD, scope=scope, reference=reference)


_SCRIPT = """
import hashlib, sys
from importlib.util import module_from_spec, spec_from_file_location
spec = spec_from_file_location("views", sys.argv[1])
views = module_from_spec(spec)
spec.loader.exec_module(views)
digest = hashlib.sha256()
for seed in range(3):
    stereo = views.calibrate(0.055, seed=seed)[0].stereo
    digest.update(repr((stereo.scope.intrinsics, stereo.scope.distortion)).encode())
    digest.update(stereo.scope_from_reference.tobytes() + stereo.scope.camera_from_board.tobytes())
print(digest.hexdigest())
"""


def test_same_views_give_the_same_bits_in_every_process_on_any_number_of_threads():
    found = set()
    for threads in ("1", "2", "2"):
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": threads, "OMP_NUM_THREADS": threads}
        command = [sys.executable, "-c", _SCRIPT, __file__]
        done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)  # noqa: S603 - our own script
        found.add(done.stdout)
    assert len(found) == 1


def test_a_board_is_placed_where_it_is():
    model = camera(SCOPE, BrownDistortion(k1=-0.2))
    where = board_poses(1, 3)[0]
    np.testing.assert_allclose(place_board(model, views(model, [where])[0], BOARD.corners), where, atol=1e-6)


def test_poses_and_vectors_are_each_others_inverse():
    poses = np.array(board_poses(4, 5))
    np.testing.assert_allclose(vectors_as_poses(np.array([pose_as_vector(p) for p in poses])), poses, atol=1e-12)


def test_rays_of_a_distorting_lens_come_back_to_their_pixels():
    model = camera(SCOPE, BrownDistortion(k1=-0.25, k2=0.06, p1=0.002, p2=-0.001))
    pixels = model.project(model.undistorted_rays()) - 0.5
    v, u = np.mgrid[:256, :256]
    np.testing.assert_allclose(pixels, np.stack([u, v], axis=-1), atol=1e-3)  # px
