import math

import numpy as np
import pytest

from laploop.assets.dof_target import DepthOfFieldTarget
from laploop.errors import InvalidValueError


@pytest.fixture(scope="module")
def target():
    return DepthOfFieldTarget()


def albedo_at(target, x_mm, y_mm):
    """Albedo of the cells under points of the target."""
    surface = target.surface()
    cells = 1e3 * surface.points.reshape(-1, 4, 3)
    low, high = cells.min(axis=1), cells.max(axis=1)
    x, y = np.broadcast_arrays(np.asarray(x_mm)[:, None], y_mm)
    inside = (x > low[:, 0]) & (x < high[:, 0]) & (y > low[:, 1]) & (y < high[:, 1])
    assert (inside.sum(axis=1) == 1).all()  # no gap, no overlap
    return surface.albedo_factor[::4][inside.argmax(axis=1)]


def test_cells_cover_the_whole_target_once(target):
    surface = target.surface()
    corners = surface.points[surface.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] < 0.0).all()  # all face the camera
    assert -0.5e6 * normals[:, 2].sum() == pytest.approx(56.0 * 32.0, rel=1e-9)  # mm²


def test_a_mark_stands_at_every_millimetre_and_nowhere_between(target):
    at_marks = np.arange(-25.0, 26.0)
    assert (albedo_at(target, at_marks + 0.01, 9.0) < 0.5).all()
    between = np.arange(-25.0, 25.0) + 0.5
    assert (albedo_at(target, between, 9.0) == 1.0).all()


def test_longer_marks_stand_at_five_and_ten_millimetres(target):
    marks = np.arange(-25.0, 26.0)
    below_short = marks[albedo_at(target, marks + 0.01, 11.5) < 0.5] + target.centre_mm
    below_middle = marks[albedo_at(target, marks + 0.01, 13.0) < 0.5] + target.centre_mm
    np.testing.assert_array_equal(below_short, np.arange(0.0, 51.0, 5.0))
    np.testing.assert_array_equal(below_middle, [0.0, 10.0, 20.0, 25.0, 30.0, 40.0, 50.0])


def test_the_middle_mark_is_the_thickest(target):
    places = np.array([-0.3, 0.3, 4.7, 5.3])
    np.testing.assert_array_equal(albedo_at(target, places, 9.0) < 0.5, [True, True, False, False])


def test_the_part_above_the_scale_is_blank(target):
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-27.9, 27.9, 500), rng.uniform(-11.9, 7.9, (500, 1))
    assert (albedo_at(target, x, y) == 1.0).all()


def test_the_middle_mark_lies_on_the_camera_axis_and_the_scale_runs_away(target):
    pose = target.camera_from_target(0.07)
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
    np.testing.assert_allclose(pose[:3, 3], [0.0, 0.0, 0.07])
    end = pose @ [0.020, 0.0, 0.0, 1.0]
    np.testing.assert_allclose(end[:3], [0.020 * math.sqrt(0.5), 0.0, 0.07 + 0.020 * math.sqrt(0.5)], atol=1e-12)


@pytest.mark.parametrize(("field", "value"), [("length_mm", 55), ("tilt_rad", 1.5), ("mark_width_mm", 0.9), ("margin_mm", 0.0)])
def test_impossible_targets_are_refused_by_name(field, value):
    with pytest.raises(InvalidValueError, match=field):
        DepthOfFieldTarget(**{field: value})
