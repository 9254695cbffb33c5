import numpy as np
import pytest

from laploop.control.targeting.surface_patch import fit_even_patch, fit_patch
from laploop.errors import InvalidValueError

RADIUS = 0.0045


def patch_points(rig, depth_m, pixel, reach=13):
    column, row = int(pixel[0]), int(pixel[1])
    window = (slice(row - reach, row + reach + 1), slice(column - reach, column + reach + 1))
    return (rig.camera.rays[window] * depth_m[window][..., None]).reshape(-1, 3), rig.camera.rays[row, column]


def degrees_between(a, b):
    return np.degrees(np.arccos(np.clip(a @ b, -1.0, 1.0)))


def test_plane_is_met_exactly(rig):
    normal = np.array([0.5, -0.3, -1.0]) / np.linalg.norm([0.5, -0.3, -1.0])
    depth = (normal @ np.array([0.0, 0.0, 0.09])) / (rig.camera.rays @ normal)
    points, ray = patch_points(rig, depth, (160.5, 100.5))
    patch = fit_patch(points, ray, radius_m=RADIUS)
    np.testing.assert_allclose(patch.point, ray * depth[100, 160], atol=1e-9)  # metres, rounding of the solve
    np.testing.assert_allclose(patch.normal, normal, atol=1e-7)


def test_sphere_is_met_to_a_few_micrometres(rig, sphere):
    pixel = sphere.pixel(0.008, -0.001)
    point, normal = sphere.surface_at(pixel)
    points, ray = patch_points(rig, sphere.depth(), pixel)
    patch = fit_patch(points, ray, radius_m=RADIUS)
    assert np.linalg.norm(patch.point - point) < 1e-5  # metres: third order of a 15 mm sphere over 2 mm
    assert degrees_between(patch.normal, normal) < 1.0  # 0.6 measured, of the same origin


def test_outliers_in_a_third_of_the_pixels_change_little(rig, sphere):
    rng = np.random.default_rng(0)
    pixel = sphere.pixel(0.006, -0.004)
    point, normal = sphere.surface_at(pixel)
    for _ in range(10):
        depth = sphere.depth() + 1e-4 * rng.normal(size=(256, 256))
        wrong = rng.random(depth.shape) < 0.3
        depth[wrong] += rng.uniform(0.003, 0.02, np.count_nonzero(wrong))  # all on one side, the worst case
        points, ray = patch_points(rig, depth, pixel)
        patch = fit_patch(points, ray, radius_m=RADIUS)
        assert np.linalg.norm(patch.point - point) < 1e-4  # metres: the noise's own size
        assert degrees_between(patch.normal, normal) < 3.0


def test_step_to_another_surface_is_ignored(rig):
    depth = np.full((256, 256), 0.09)
    depth[:, 135:] = 0.1  # a fold's edge 6 pixels, about 2.4 mm, beside the target
    points, ray = patch_points(rig, depth, (128.5, 128.5))
    patch = fit_patch(points, ray, radius_m=RADIUS)
    np.testing.assert_allclose(patch.point[2], 0.09, atol=5e-5)  # metres, the fit's smallest scale
    assert degrees_between(patch.normal, np.array([0.0, 0.0, -1.0])) < 1.0


def test_blurred_step_to_another_surface_is_left_out(rig):
    row, column = np.mgrid[:256, :256]
    # A wall 16 mm high, 7 pixels, about 3 mm, beside the target, blurred over 4 pixels, as networks do.
    depth = 0.09 - 0.016 / (1.0 + np.exp((column - 128.0 - 0.7 * (row - 128.0) + 9.0) / 1.2))
    points, ray = patch_points(rig, depth, (128.5, 128.5))
    inside = np.hypot(*(points[:, :2] - ray[:2] * points[:, 2:]).T) < RADIUS
    facing = np.array([0.0, 0.0, -1.0])
    assert degrees_between(fit_patch(points[inside], ray, radius_m=RADIUS).normal, facing) > 40.0
    patch = fit_even_patch(points[inside], ray, radius_m=RADIUS, max_spread_m=4e-4)
    assert degrees_between(patch.normal, facing) < 10.0
    np.testing.assert_allclose(patch.point[2], 0.09, atol=3e-4)


def test_where_no_smaller_patch_is_even_the_whole_is_taken(rig):
    depth = 0.09 + 0.002 * np.random.default_rng(0).normal(size=(256, 256))
    points, ray = patch_points(rig, depth, (128.5, 128.5))
    even = fit_even_patch(points, ray, radius_m=RADIUS, max_spread_m=4e-4)
    np.testing.assert_array_equal(even.normal, fit_patch(points, ray, radius_m=RADIUS).normal)


def test_few_points_are_fitted_by_a_plane():
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-0.002, 0.002, (8, 2)), np.full(8, 0.09)])
    patch = fit_patch(points, np.array([0.0, 0.0, 1.0]), radius_m=RADIUS)
    np.testing.assert_allclose(patch.point, [0.0, 0.0, 0.09], atol=1e-9)  # metres, rounding


def test_too_few_points_are_refused():
    with pytest.raises(InvalidValueError, match="number of points"):
        fit_patch(np.zeros((5, 3)), np.array([0.0, 0.0, 1.0]), radius_m=RADIUS)
