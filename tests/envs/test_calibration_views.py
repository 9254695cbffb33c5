"""Calibration of the simulated cameras from their own pictures, against what only a simulator knows."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from laploop.assets.calibration_board import CalibrationBoard
from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.optics_presets import optics_preset
from laploop.envs.sensors.reference_camera import ReferenceCamera, lateral_mount
from laploop.envs.sensors.reference_optics import ReferenceOptics
from laploop.envs.sensors.scene_geometry import SceneGeometry
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.perception.calibration.board_corners import find_corners_of_views
from laploop.perception.calibration.results import transform_residual
from laploop.perception.calibration.solve import calibrate_camera, calibrate_stereo
from laploop.perception.geometry import Rig, invert_transform, transform_points

BOARD = CalibrationBoard()
VIEWS = 20
CLEAR = StripeMask(profile=(1.0,))  # a window in the place of the mask: even light
STANDING = np.diag([1.0, -1.0, -1.0, 1.0])  # camera that looks down the world's z axis


class Bench:
    """A board that is moved in front of cameras."""

    def __init__(self, board):
        self.board = board
        self.surface = board.surface()
        self.geometry = SceneGeometry(
            points=self.surface.points,
            triangles=self.surface.triangles,
            object_ids=int(ObjectId.OTHER),
            albedo_factor=self.surface.albedo_factor,
        )

    def place(self, world_from_board):
        self.geometry.move(transform_points(world_from_board, self.surface.points))


def scope_camera(optics="paper", **changes):
    return StripeCamera(Rig.from_optics(replace(ScopeOptics(mask=CLEAR), **changes)), optics_preset(optics), threads=1)


def tilted(base, middle, tilt_deg, turn_deg, board=BOARD):
    """Pose of a board whose middle is at `middle`, turned from the orientation `base` (3, 3) in its own frame."""
    pose = np.eye(4)
    pose[:3, :3] = base @ Rotation.from_euler("zxy", [turn_deg, *tilt_deg], degrees=True).as_matrix()
    pose[:3, 3] = middle - pose[:3, :3] @ board.centre
    return pose


def room_beside(board, depth_m, tangent):
    """How far a board of any orientation may be off the axis of a camera whose half field has this tangent."""
    return max(0.0, tangent * depth_m - 0.4 * math.hypot(*board.size_m))


def poses_in_view(rng, near_m, far_m, tangent, board=BOARD, tilt_deg=35.0):
    """Poses in a camera's frame that spread a board over its field and its range, all of it seen."""
    for index in range(VIEWS):
        depth = near_m + (far_m - near_m) * (index + 0.5) / VIEWS
        room = room_beside(board, depth, tangent)
        middle = [*rng.uniform(-room, room, 2), depth]
        yield tilted(np.eye(3), middle, rng.uniform(-tilt_deg, tilt_deg, 2), rng.uniform(-180.0, 180.0), board)


def test_light_without_stripes_is_even():
    striped, clear = (StripeCamera(Rig.from_optics(ScopeOptics(mask=mask)), threads=1) for mask in (StripeMask(), CLEAR))
    contrasts = []
    for camera in (striped, clear):
        bench = Bench(replace(BOARD, square_mm=30.0, border_mm=30.0))
        camera.attach_geometry(bench.geometry)
        bench.place(tilted(np.eye(3), [0.0, 0.0, 0.09], [0.0, 0.0], 0.0, bench.board))
        # Rows and columns of one square, 74 px wide; a period of the stripes has 13.
        values = camera.capture(None, np.eye(4), None).electrons[100:150, 140:190]
        contrasts.append(float(np.ptp(values) / (values.max() + values.min())))
    assert contrasts[0] > 0.4
    assert contrasts[1] < 0.1  # fall-off towards the border of the field


@pytest.mark.parametrize("seed", [1, 2])
def test_scope_camera_is_calibrated_from_twenty_of_its_pictures(seed):
    rng = np.random.default_rng(seed)
    scope, bench = scope_camera(), Bench(BOARD)
    scope.attach_geometry(bench.geometry)
    images, poses = [], list(poses_in_view(rng, 0.07, 0.12, math.tan(math.radians(30.0))))
    for pose in poses:
        bench.place(pose)
        images.append(scope.capture(None, np.eye(4), rng).image)
    found = calibrate_camera(find_corners_of_views(images, BOARD), BOARD, width=256, height=256)
    true = scope.rig.camera
    assert found.error_px < 0.3
    assert max(found.view_errors_px) < 0.3
    assert found.intrinsics.fx == pytest.approx(true.fx, rel=0.005)
    assert found.intrinsics.fy == pytest.approx(true.fy, rel=0.005)
    assert found.intrinsics.cx == pytest.approx(true.cx, abs=1.5)
    assert found.intrinsics.cy == pytest.approx(true.cy, abs=1.5)
    residuals = [transform_residual(one, other) for one, other in zip(found.camera_from_board, poses, strict=True)]
    degrees, mm = np.max(residuals, axis=0)
    # Of one view of 42 corners that are good to 0.08 px: half a degree, half a millimetre at most.
    assert degrees < 0.5
    assert mm < 0.5


def stereo_residual(seed, scope, second, picture_of_second, world_from_second, second_calibration):
    """Calibrate the scope and the pair from the same pictures; return the calibration and its distance from the truth."""
    rng = np.random.default_rng(seed)
    bench = Bench(BOARD)
    for camera in (scope, second):
        camera.attach_geometry(bench.geometry)
    # The board looks half-way between the two cameras.
    between = STANDING[:3, 2] + world_from_second[:3, 2]
    down = between / np.linalg.norm(between)
    across = np.cross([0.0, 1.0, 0.0], down)
    across /= np.linalg.norm(across)
    base = np.column_stack([across, np.cross(down, across), down])
    scope_images, second_images = [], []
    for index in range(VIEWS):
        depth = 0.07 + 0.05 * (index + 0.5) / VIEWS
        room = room_beside(BOARD, depth, math.tan(math.radians(30.0)))
        middle = np.array([*rng.uniform(-room, room, 2), 0.09 - depth])
        bench.place(tilted(base, middle, rng.uniform(-30.0, 30.0, 2), rng.uniform(-180.0, 180.0)))
        scope_images.append(scope.capture(None, world_from_scope(), rng).image)
        second_images.append(picture_of_second(second.capture(None, world_from_second, rng)))
    in_scope, in_second = (find_corners_of_views(images, BOARD) for images in (scope_images, second_images))
    scope_calibration = calibrate_camera(in_scope, BOARD, width=256, height=256)
    if second_calibration is None:
        height, width = second_images[0].shape[:2]
        second_calibration = calibrate_camera(in_second, BOARD, width=width, height=height)
    pair = calibrate_stereo(in_scope, in_second, BOARD, scope=scope_calibration, reference=second_calibration)
    true = invert_transform(world_from_scope()) @ world_from_second
    return pair, transform_residual(pair.scope_from_reference, true)


def world_from_scope():
    pose = STANDING.copy()
    pose[2, 3] = 0.09
    return pose


@pytest.mark.parametrize("seed", [1, 2])
def test_transform_between_two_scopes_is_found(seed):
    second = scope_camera(width=512, height=512)
    world_from_second = lateral_mount([0.0, 0.0, 0.0], distance_m=0.12, elevation_rad=math.radians(55.0))
    pair, (degrees, mm) = stereo_residual(seed, scope_camera(), second, lambda c: c.image, world_from_second, None)
    assert pair.error_px < 0.3
    assert degrees < 0.1
    assert mm < 0.5


@pytest.mark.slow
def test_transform_to_the_reference_camera_is_found():
    """The reference camera is calibrated with a large board that fills its field, as its maker does; then the pair."""
    reference = ReferenceCamera(ReferenceOptics())
    large = CalibrationBoard(square_mm=30.0, border_mm=30.0, edge_mm=0.8)
    rng = np.random.default_rng(7)
    bench = Bench(large)
    reference.attach_geometry(bench.geometry)
    images = []
    for pose in poses_in_view(rng, 0.45, 0.75, 0.41, large):
        bench.place(pose)
        images.append(reference.capture(None, np.eye(4), rng).rgba)
    corners = find_corners_of_views(images, large)
    k = reference.intrinsics
    factory = calibrate_camera(corners, large, width=k.width, height=k.height)
    mount = lateral_mount([0.0, 0.0, 0.0])
    pair, (degrees, mm) = stereo_residual(1, scope_camera(), reference, lambda c: c.rgba, mount, factory)
    assert factory.error_px < 0.3
    assert pair.error_px < 0.3
    assert degrees < 0.1
    assert mm < 0.5
