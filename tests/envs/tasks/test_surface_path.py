import numpy as np
import pytest

from laploop.envs.tasks.surface_point import SurfacePath
from laploop.errors import InvalidValueError

GRID = np.stack(np.meshgrid(np.linspace(0.0, 0.1, 11), np.linspace(0.0, 0.1, 11), indexing="ij"), axis=-1).reshape(-1, 2)
POINTS = np.column_stack([GRID, np.zeros(len(GRID))])
CELLS = [(11 * i + j) for i in range(10) for j in range(10)]
TRIANGLES = np.array([triangle for c in CELLS for triangle in ((c, c + 11, c + 12), (c, c + 12, c + 1))])


def path():
    """Draw an L on a plane: 30 mm along x, then 20 mm along y."""
    corners = np.array([[0.02, 0.02, -0.1], [0.05, 0.02, -0.1], [0.05, 0.04, -0.1]])
    return SurfacePath.from_rays(POINTS, TRIANGLES, np.array([0.0, 0.0, 0.1]), corners)


def test_length_and_points_are_those_of_the_polyline():
    drawn = path()
    assert drawn.length_m == pytest.approx(0.05)
    np.testing.assert_allclose(drawn.at(POINTS, 0.04).position, [0.05, 0.03, 0.0], atol=1e-12)
    np.testing.assert_allclose(drawn.at(POINTS, 1.0).position, [0.05, 0.04, 0.0], atol=1e-12)
    np.testing.assert_allclose(drawn.at(POINTS, -1.0).position, [0.02, 0.02, 0.0], atol=1e-12)


def test_the_foot_is_the_nearest_point_and_has_the_surfaces_normal():
    foot = path().nearest(POINTS, np.array([0.033, 0.019, 0.01]), 0.0, 0.05)
    assert foot.along_m == pytest.approx(0.013)
    np.testing.assert_allclose(foot.position, [0.033, 0.02, 0.0], atol=1e-12)
    np.testing.assert_allclose(foot.normal, [0.0, 0.0, 1.0], atol=1e-12)


def test_the_foot_stays_within_the_window():
    drawn, point = path(), np.array([0.05, 0.04, 0.0])
    assert drawn.nearest(POINTS, point, 0.010, 0.020).along_m == pytest.approx(0.020)
    assert drawn.nearest(POINTS, point, 0.0, 0.05).along_m == pytest.approx(0.05)


def test_the_path_moves_with_the_tissue():
    moved = POINTS + [0.0, 0.0, 0.005]
    np.testing.assert_allclose(path().positions(moved)[1], [0.05, 0.02, 0.005], atol=1e-12)


def test_a_path_of_one_point_or_without_length_is_refused():
    ray = np.array([[0.02, 0.02, -0.1]])
    for rays, message in ((ray, "number of points"), (np.repeat(ray, 2, axis=0), "length of a path")):
        with pytest.raises(InvalidValueError, match=message):
            SurfacePath.from_rays(POINTS, TRIANGLES, np.array([0.0, 0.0, 0.1]), rays)
