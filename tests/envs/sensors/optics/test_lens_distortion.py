from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.ndimage import center_of_mass

from laploop.assets.calibration_board import CalibrationBoard
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.optics.lens_distortion import distorted_rays
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.envs.sensors.tracing.scene_geometry import SceneGeometry
from laploop.errors import InvalidValueError
from laploop.perception.calibration.board_corners import find_corners
from laploop.perception.calibration.solve import calibrate_camera
from laploop.perception.geometry import Rig
from laploop.perception.reprojection import BrownDistortion

LENS = BrownDistortion(k1=-0.18, k2=0.03, p1=0.004, p2=-0.003)


@pytest.fixture(scope="module")
def distorting(rig):
    return StripeCamera(rig, StripeOptics(distortion=LENS))


def test_rays_are_those_that_the_lens_shows_at_the_pixels(rig):
    rays = distorted_rays(rig.camera, LENS)
    shown = np.stack(LENS.apply(rays[..., 0], rays[..., 1]), axis=-1)
    np.testing.assert_allclose(shown, rig.camera.rays[..., :2], atol=1e-10)
    matrix, coefficients = rig.camera.matrix, np.array([LENS.k1, LENS.k2, LENS.p1, LENS.p2])
    u, v = cv2.projectPoints(rays.reshape(-1, 3), np.zeros(3), np.zeros(3), matrix, coefficients)[0][:, 0].T
    np.testing.assert_allclose(u.reshape(256, 256)[40], np.arange(256) + 0.5, atol=1e-6)
    np.testing.assert_allclose(v.reshape(256, 256)[:, 40], np.arange(256) + 0.5, atol=1e-6)


@pytest.mark.parametrize("lens", [BrownDistortion(k1=-0.35), BrownDistortion(k1=-2.0), BrownDistortion(k2=-5.0)])
def test_a_lens_that_leaves_corners_empty_is_refused(rig, lens):
    with pytest.raises(InvalidValueError, match="distortion"):
        distorted_rays(rig.camera, lens)
    camera = StripeCamera(rig)
    with pytest.raises(InvalidValueError, match="corner"):
        camera.set_optics(StripeOptics(distortion=lens))


def test_depth_is_z_along_the_distorted_rays(distorting, rig, make_plane):
    tilt = 0.5
    distorting.attach_geometry(make_plane(0.09, tilt_x=tilt, tilt_y=-0.3))
    view = distorting.exact(None, np.eye(4))
    rays = distorted_rays(rig.camera, LENS)
    depth = 90.0 / (1.0 - rays[..., 0] * np.tan(tilt) - rays[..., 1] * np.tan(-0.3))
    np.testing.assert_allclose(view.depth_mm, depth, rtol=2e-6)
    np.testing.assert_allclose(view.projector_x, rays[..., 0] - rig.baseline_m * 1e3 / depth, atol=1e-6)


def test_known_points_are_seen_where_lens_and_matrix_put_them(distorting, rig):
    rng = np.random.default_rng(2)
    points = np.column_stack([rng.uniform(-0.04, 0.04, (12, 2)), rng.uniform(0.08, 0.1, 12)])
    radius = 0.0015
    octahedron = np.concatenate([np.eye(3), -np.eye(3)]) * radius
    faces = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]])
    scene = SceneGeometry(
        points=(points[:, None] + octahedron).reshape(-1, 3),
        triangles=(faces + 6 * np.arange(12)[:, None, None]).reshape(-1, 3),
        object_ids=np.repeat([ObjectId.OTHER, ObjectId.TOOL], 48),
    )
    distorting.attach_geometry(scene)
    view = distorting.exact(None, np.eye(4))
    u, v = (rig.camera.matrix[:2, :2] @ np.array(LENS.apply(*(points[:, :2] / points[:, 2:]).T))) + 128.0
    straight = rig.camera.project(points)
    assert np.abs(np.stack([u, v], axis=1) - straight).max() > 3.0  # px: the lens matters
    for k in range(12):
        window = np.zeros((256, 256), dtype=bool)
        window[max(0, int(v[k]) - 8) : int(v[k]) + 9, max(0, int(u[k]) - 8) : int(u[k]) + 9] = True
        seen = window & (np.abs(view.depth_mm - 1e3 * points[k, 2]) < 2e3 * radius)
        row, column = center_of_mass(seen)
        # The middle of some 30 pixels, each in or out as its centre is.
        assert (column + 0.5, row + 0.5) == pytest.approx((u[k], v[k]), abs=0.35)
        # The tip falls between pixels of 0.45 mm, and the faces fall off by 45 degrees.
        assert view.depth_mm[seen].min() == pytest.approx(1e3 * (points[k, 2] - radius), abs=0.5)


def test_straight_rays_walked_through_the_tree_give_the_image_of_the_depth_map(rig):
    # So weak a lens that no ray moves by more than 1e-7, which no float32 depth shows.
    rng = np.random.default_rng(1)
    points = rng.uniform(-0.05, 0.05, (60, 1, 3)) + np.array([0.0, 0.0, 0.11]) + rng.normal(0.0, 0.012, (60, 3, 3))
    scene = SceneGeometry(points=points.reshape(-1, 3), triangles=np.arange(180).reshape(-1, 3), object_ids=ObjectId.OTHER)
    views = []
    for lens in (BrownDistortion(), BrownDistortion(k1=1e-8)):
        camera = StripeCamera(rig, StripeOptics(distortion=lens))
        camera.attach_geometry(scene)
        views.append(camera.exact(None, np.eye(4)))
    hit = [np.isfinite(view.depth_mm) for view in views]
    both = hit[0] & hit[1]
    assert both.sum() > 20000
    assert (hit[0] != hit[1]).sum() < 30  # centres of pixels on an edge within rounding
    off = np.abs(views[0].depth_mm[both] - views[1].depth_mm[both]) > 1e-3
    assert off.sum() < 30
    assert (views[0].lit[both] != views[1].lit[both]).mean() < 2e-3


def test_a_lens_can_be_put_on_and_taken_off_again(rig, make_plane):
    camera = StripeCamera(rig)
    camera.attach_geometry(make_plane(0.09, tilt_x=0.2))
    straight = camera.capture(None, np.eye(4), np.random.default_rng(0))
    camera.set_optics(StripeOptics(distortion=LENS))
    bent = camera.capture(None, np.eye(4), np.random.default_rng(0))
    camera.set_optics(StripeOptics())
    again = camera.capture(None, np.eye(4), np.random.default_rng(0))
    assert (bent.image != straight.image).mean() > 0.3
    np.testing.assert_array_equal(again.image, straight.image)
    np.testing.assert_array_equal(again.depth_mm, straight.depth_mm)


def board_view(camera, board, rotation, centre):
    surface = board.surface()
    middle = 0.5 * (board.corners[0] + board.corners[-1])
    points = (surface.points - middle) @ cv2.Rodrigues(np.asarray(rotation))[0].T + centre
    scene = SceneGeometry(
        points=points, triangles=surface.triangles, object_ids=ObjectId.OTHER, albedo_factor=surface.albedo_factor
    )
    camera.attach_geometry(scene)
    return camera.capture(None, np.eye(4), None).image


def test_calibration_recovers_the_lens(rig):
    # A clear mask, as one would project for a calibration, and pixels enough to see the lens.
    wide = replace(rig.camera, width=512, height=512, fx=2 * rig.camera.fx, fy=2 * rig.camera.fy, cx=256.0, cy=256.0)
    clear = Rig(camera=wide, baseline_m=rig.baseline_m, mask=replace(rig.mask, profile=(1.0,), fov_rad=1.6))
    lens = BrownDistortion(k1=-0.2)
    camera = StripeCamera(clear, StripeOptics(distortion=lens, led_power_w=0.08, bits=8))
    board = CalibrationBoard()
    rng = np.random.default_rng(6)
    views = []
    for _ in range(14):
        rotation = rng.uniform(-0.5, 0.5, 3)
        centre = np.array([*rng.uniform(-0.016, 0.016, 2), rng.uniform(0.075, 0.1)])
        corners = find_corners(board_view(camera, board, rotation, centre), board)
        if corners is not None:
            views.append(corners)
    assert len(views) >= 10
    found = calibrate_camera(views, board, width=512, height=512)
    assert found.distortion.k1 == pytest.approx(lens.k1, abs=0.02)
    assert found.intrinsics.fx == pytest.approx(wide.fx, rel=0.005)
    assert found.intrinsics.cx == pytest.approx(wide.cx, abs=1.0)
