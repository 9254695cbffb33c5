import numpy as np
import pytest
from scipy import ndimage

from laploop.assets.scope_optics import ScopeOptics
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.reference.camera import ReferenceCamera, lateral_mount
from laploop.envs.sensors.reference.optics import ReferenceOptics
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.envs.theatre.config import TheatreConfig
from laploop.envs.theatre.theatre import Theatre
from laploop.errors import InvalidValueError
from laploop.perception.geometry import Intrinsics, Rig, invert_transform, transform_points
from laploop.perception.reprojection import BrownDistortion, reproject

SCOPE = Intrinsics(width=64, height=48, fx=60.0, fy=55.0, cx=31.0, cy=25.5)
MM = 1e-4  # float32 rounding of depths up to 1 m


def turn(axis, angle, offset=(0.0, 0.0, 0.0)):
    """Return a rigid transform: Rodrigues' formula."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    transform = np.eye(4)
    transform[:3, :3] = np.eye(3) + np.sin(angle) * skew + (1.0 - np.cos(angle)) * skew @ skew
    transform[:3, 3] = offset
    return transform


def one_by_one(xyz_mm, transform, camera, distortion=None):
    """Follow the paper's equations, a point at a time."""
    depth = np.full((camera.height, camera.width), np.nan)
    for point in xyz_mm.reshape(-1, 3).astype(np.float64):
        x, y, z = transform[:3, :3] @ point + 1e3 * transform[:3, 3]
        if not np.isfinite([x, y, z]).all() or z <= 0.0:
            continue
        x, y = x / z, y / z
        if distortion is not None:
            x, y = (float(value) for value in distortion.apply(np.array(x), np.array(y)))
        column, row = int(np.floor(camera.fx * x + camera.cx)), int(np.floor(camera.fy * y + camera.cy))
        if 0 <= column < camera.width and 0 <= row < camera.height:
            depth[row, column] = np.nanmin([depth[row, column], z])
    return depth


def back_project(depth_mm, camera):
    return (camera.rays * depth_mm[..., None]).astype(np.float32)


def test_back_projection_and_reprojection_into_the_same_camera_change_nothing():
    depth = np.random.default_rng(0).uniform(50.0, 150.0, (48, 64)).astype(np.float32)
    depth[3, 5] = np.nan
    xyz = back_project(depth, SCOPE)
    # The centre of the pixel in row 10, column 20 is at (20.5, 10.5).
    expected = np.array([(20.5 - 31.0) / 60.0, (10.5 - 25.5) / 55.0, 1.0]) * depth[10, 20]
    np.testing.assert_allclose(xyz[10, 20], expected, atol=MM)
    again = reproject(xyz, np.eye(4), SCOPE)
    assert again.depth_mm.dtype == np.float32
    np.testing.assert_allclose(again.depth_mm, depth, atol=MM)
    np.testing.assert_array_equal(again.mask, np.isfinite(depth))


def test_plane_seen_from_the_side_is_exact():
    camera_from_plane = turn([1.0, 0.0, 0.0], 0.6, [0.002, -0.003, 0.1])
    side = np.linspace(-120.0, 120.0, 1501)
    x, y = np.meshgrid(side, side)
    plane = np.stack([x, y, np.zeros_like(x)], axis=-1)
    reference_from_plane = turn([0.2, 1.0, 0.1], -0.7, [0.1, 0.05, 0.6])
    xyz = transform_points(reference_from_plane, plane * 1e-3) * 1e3
    result = reproject(xyz, camera_from_plane @ invert_transform(reference_from_plane), SCOPE)
    normal, point = camera_from_plane[:3, 2], camera_from_plane[:3, 3] * 1e3
    depth = (normal @ point) / (SCOPE.rays @ normal)
    inside = (depth > 0.0) & (
        np.abs(transform_points(invert_transform(camera_from_plane), SCOPE.rays * depth[..., None] * 1e-3)) < 0.117
    ).all(axis=-1)
    assert inside.mean() > 0.5
    assert result.mask[inside].all()
    # The nearest of the points in a pixel lies at most half a pixel from its centre in each direction, and one of the
    # 0.16 mm grid is close to the corner where the plane is nearest.
    slope = np.abs(np.gradient(depth, axis=0)) + np.abs(np.gradient(depth, axis=1))
    error = result.depth_mm - depth
    assert (error[inside] < 0.2).all()
    assert (error[inside] > -0.55 * slope[inside] - 0.01).all()


def test_nearest_of_two_layers_wins():
    far = back_project(np.full((48, 64), 120.0), SCOPE)
    near = back_project(np.full((48, 64), 80.0), SCOPE)[10:20, 30:40]
    for order in ([far.reshape(-1, 3), near.reshape(-1, 3)], [near.reshape(-1, 3), far.reshape(-1, 3)]):
        result = reproject(np.concatenate(order), np.eye(4), SCOPE)
        expected = np.full((48, 64), 120.0)
        expected[10:20, 30:40] = 80.0
        np.testing.assert_allclose(result.depth_mm, expected, atol=MM)
        assert result.mask.all()


def test_points_behind_outside_or_missing_are_left_out():
    centre = (np.array([32.5, 24.5]) - [31.0, 25.5]) / [60.0, 55.0]
    good = np.array([*centre * 90.0, 90.0])
    points = np.array(
        [
            good,
            -good,
            [0.0, 0.0, 0.0],
            [5.0, 0.0, 0.0],
            [1e6, 0.0, 100.0],
            [-52.0, 0.0, 100.0],
            [np.nan, 0.0, 100.0],
            [0.0, 0.0, np.nan],
            [np.inf, 0.0, 100.0],
            [0.0, 0.0, np.inf],
        ]
    )
    for distortion in (None, BrownDistortion()):
        result = reproject(points, np.eye(4), SCOPE, distortion)
        np.testing.assert_array_equal(np.argwhere(result.mask), [[24, 32]])
        assert result.depth_mm[24, 32] == pytest.approx(90.0, abs=MM)
        assert np.isnan(result.depth_mm).sum() == 48 * 64 - 1


def test_borders_of_the_image_are_those_of_its_outermost_pixels():
    u = np.array([1e-6, -1e-6, 63.999999, 64.000001])
    points = np.stack([(u - SCOPE.cx) / SCOPE.fx * 100.0, np.zeros(4), np.full(4, 100.0)], axis=-1)
    columns = [np.argwhere(reproject(point[None], np.eye(4), SCOPE).mask)[:, 1].tolist() for point in points]
    assert columns == [[0], [], [63], []]


@pytest.mark.parametrize("distortion", [None, BrownDistortion(k1=-0.25, k2=0.08, p1=0.003, p2=-0.002, k3=-0.01)])
@pytest.mark.parametrize("seed", [0, 1])
def test_random_clouds_agree_with_the_equations_followed_point_by_point(seed, distortion):
    rng = np.random.default_rng(seed)
    xyz = rng.uniform([-90.0, -90.0, -40.0], [90.0, 90.0, 160.0], (20_000, 3)).astype(np.float32)
    xyz[rng.random(20_000) < 0.1] = np.nan
    transform = turn(rng.standard_normal(3), 0.5, rng.uniform(-0.02, 0.02, 3))
    result = reproject(xyz.reshape(100, 200, 3), transform, SCOPE, distortion)
    expected = one_by_one(xyz, transform, SCOPE, distortion)
    if distortion is not None:
        # The straightforward way also shows what lies beyond the lens's largest angle, folded back into the image.
        inner = xyz.astype(np.float64) @ transform[:3, :3].T + 1e3 * transform[:3, 3]
        outside = np.hypot(inner[:, 0], inner[:, 1]) >= distortion.largest_radius_tan * inner[:, 2]
        expected = one_by_one(np.where(outside[:, None], np.nan, xyz), transform, SCOPE, distortion)
    np.testing.assert_allclose(result.depth_mm, expected, atol=MM)
    assert 0.3 < result.mask.mean() < 1.0


def test_distortion_agrees_with_a_value_worked_out_by_hand():
    # x = 0.3, y = 0.4: r² = 0.25; radial 1 + 0.1 * 0.25 - 0.2 * 0.0625 + 0.4 * 0.015625 = 1.01875;
    # x' = 0.305625 + 2 * 0.01 * 0.12 + 0.02 (0.25 + 0.18) = 0.316625
    # y' = 0.4075 + 0.01 (0.25 + 0.32) + 2 * 0.02 * 0.12 = 0.418
    lens = BrownDistortion(k1=0.1, k2=-0.2, p1=0.01, p2=0.02, k3=0.4)
    x, y = lens.apply(np.array([0.3]), np.array([0.4]))
    assert x[0] == pytest.approx(0.316625, abs=1e-12)
    assert y[0] == pytest.approx(0.418, abs=1e-12)
    # u = 60 * 0.316625 + 31 = 49.9975, v = 55 * 0.418 + 25.5 = 48.49: one row below the image of 48; 24 higher it is inside.
    camera = Intrinsics(width=64, height=48, fx=60.0, fy=55.0, cx=31.0, cy=1.5)
    result = reproject(np.array([[30.0, 40.0, 100.0]]), np.eye(4), camera, lens)
    np.testing.assert_array_equal(np.argwhere(result.mask), [[24, 49]])
    assert not reproject(np.array([[30.0, 40.0, 100.0]]), np.eye(4), SCOPE, lens).mask.any()


def test_points_beyond_the_lens_largest_angle_do_not_fold_back_into_the_image():
    lens = BrownDistortion(k1=-0.25)
    # d/dr (r - 0.25 r³) = 0 at r = 2 / sqrt(3).
    assert lens.largest_radius_tan == pytest.approx(2.0 / np.sqrt(3.0))
    assert BrownDistortion().largest_radius_tan == np.inf
    assert BrownDistortion(k1=0.1, k2=0.02).largest_radius_tan == np.inf
    # r = 2 maps onto the axis.
    assert not reproject(np.array([[200.0, 0.0, 100.0]]), np.eye(4), SCOPE, lens).mask.any()
    assert reproject(np.array([[20.0, 0.0, 100.0]]), np.eye(4), SCOPE, lens).mask.any()


@pytest.mark.parametrize("shape", [(0, 3), (0, 0, 3)])
def test_no_points_make_an_empty_map(shape):
    result = reproject(np.zeros(shape, dtype=np.float32), np.eye(4), SCOPE)
    assert result.depth_mm.shape == (48, 64)
    assert np.isnan(result.depth_mm).all()
    assert not result.mask.any()


def test_bad_input_is_refused():
    points = np.zeros((4, 3))
    for wrong in (np.zeros(3), np.zeros((4, 2)), np.zeros((3, 4))):
        with pytest.raises(InvalidValueError, match="shape of xyz_mm"):
            reproject(wrong, np.eye(4), SCOPE)
    with pytest.raises(InvalidValueError, match="shape of scope_from_reference"):
        reproject(points, np.eye(3), SCOPE)
    for wrong in (2.0 * np.eye(4), np.diag([1.0, 1.0, -1.0, 1.0]), np.full((4, 4), np.nan)):
        with pytest.raises(InvalidValueError, match="scope_from_reference"):
            reproject(points, wrong, SCOPE)
    with pytest.raises(InvalidValueError, match="k2 is nan"):
        BrownDistortion(k2=np.nan)


def test_reference_depth_agrees_with_the_exact_depth_where_both_see_the_tissue():
    theatre = Theatre(TheatreConfig(seed=3))
    theatre.refresh()
    scope_pose = theatre.world_from_camera()
    rig = Rig.from_optics(ScopeOptics())
    scope = StripeCamera(rig)
    scope.attach(theatre.model, tissue=theatre.tissue)
    exact = scope.exact(theatre.data, scope_pose)
    surface = theatre.tissue.surface_points()[: theatre.tissue.top_vertex_count]
    reference_pose = lateral_mount(surface.mean(axis=0))
    # Full sampling has 0.24 mm between its points, 0.4 mm across the slanting surface; the scope's pixels are 0.45 mm wide.
    reference = ReferenceCamera(ReferenceOptics(sampling="full").ideal())
    reference.attach(theatre.model, tissue=theatre.tissue)
    capture = reference.capture(theatre.data, reference_pose, None)
    scope_from_reference = invert_transform(scope_pose) @ reference_pose
    result = reproject(capture.xyz, scope_from_reference, rig.camera)

    in_reference = transform_points(invert_transform(scope_from_reference), rig.camera.rays * exact.depth_mm[..., None] * 1e-3)
    with np.errstate(invalid="ignore"):
        pixel = np.nan_to_num(reference.intrinsics.project(in_reference)).astype(int)
    seen_mm = capture.z[pixel[..., 1].clip(0, 2047), pixel[..., 0].clip(0, 2447)]
    both = (np.abs(seen_mm - 1e3 * in_reference[..., 2]) < 1.0) & (exact.object_id == ObjectId.TISSUE)
    # Tissue with tissue around it: at outlines a pixel holds two surfaces.
    both = ndimage.binary_erosion(both, np.ones((3, 3)))
    assert both.mean() > 0.7
    assert result.mask[both].mean() > 0.95
    both &= result.mask
    error = (result.depth_mm - exact.depth_mm)[both]
    # A point falls anywhere in its pixel: the depth there lies between those of the neighbouring pixels' centres. The nearest
    # of a few points is taken, so that the error is on the near side. 0.02 mm allow for crests between centres.
    lowest = ndimage.minimum_filter(exact.depth_mm, 3)[both]
    highest = ndimage.maximum_filter(exact.depth_mm, 3)[both]
    depth = result.depth_mm[both]
    within = (depth >= lowest - 0.02) & (depth <= highest + 0.02)
    assert within.mean() > 0.995
    # Half a pixel, 0.22 mm, on the median slope of the tissue (15 degrees) is 0.06 mm; up to 0.5 mm on 65 degrees, and a
    # little more in creases.
    assert np.median(np.abs(error)) < 0.08
    assert np.percentile(np.abs(error), 99.0) < 0.6
    assert -0.1 < np.median(error) <= 0.0
