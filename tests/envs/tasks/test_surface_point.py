import numpy as np
import pytest

from laploop.envs.tasks.surface_point import SurfacePoint
from laploop.errors import InvalidValueError


def grid(height):
    """A 9x9 grid of 1 mm cells whose vertices lie at z = height(x, y), triangles facing up."""
    axis = np.linspace(-0.004, 0.004, 9)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    points = np.stack([x, y, height(x, y)], axis=-1).reshape(-1, 3)
    index = np.arange(81).reshape(9, 9)
    a, b, c, d = index[:-1, :-1].ravel(), index[1:, :-1].ravel(), index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    return points, np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def test_a_ray_meets_a_tilted_plane_where_it_should():
    points, triangles = grid(lambda x, y: 0.5 * x)
    point = SurfacePoint.from_ray(points, triangles, np.array([0.0012, 0.0007, 0.1]), np.array([0.0, 0.0, -3.0]))
    np.testing.assert_allclose(point.position(points), [0.0012, 0.0007, 0.0006], atol=1e-12)  # m, rounding only
    np.testing.assert_allclose(point.normal(points), np.array([-0.5, 0.0, 1.0]) / np.sqrt(1.25), atol=1e-12)


def test_the_point_moves_with_the_material():
    points, triangles = grid(lambda x, y: 0.0 * x)
    point = SurfacePoint.from_ray(points, triangles, np.array([0.0012, 0.0007, 0.1]), np.array([0.0, 0.0, -1.0]))
    stretched = points * [1.1, 1.0, 1.0] + [0.0, 0.0, 0.01]
    np.testing.assert_allclose(point.position(stretched), [0.00132, 0.0007, 0.01], atol=1e-12)


def test_the_normal_of_a_sphere_is_radial():
    radius = 0.03
    points, triangles = grid(lambda x, y: np.sqrt(radius**2 - x**2 - y**2))
    point = SurfacePoint.from_ray(points, triangles, np.array([0.0022, -0.0013, 0.1]), np.array([0.0, 0.0, -1.0]))
    position = point.position(points)
    # A 1 mm grid on a 30 mm sphere turns by 2 degrees a cell; smooth normals stay within a fraction of that.
    angle = np.degrees(np.arccos(point.normal(points) @ position / np.linalg.norm(position)))
    assert angle < 0.3


def test_the_nearest_of_two_layers_is_taken():
    points, triangles = grid(lambda x, y: 0.0 * x)
    both = np.concatenate([points, points + [0.0, 0.0, 0.02]])
    faces = np.concatenate([triangles, triangles + len(points)])
    point = SurfacePoint.from_ray(both, faces, np.array([0.0003, 0.0004, 0.1]), np.array([0.0, 0.0, -1.0]))
    assert point.position(both)[2] == pytest.approx(0.02)


def test_a_ray_that_misses_is_an_error():
    points, triangles = grid(lambda x, y: 0.0 * x)
    with pytest.raises(InvalidValueError, match="meets the tissue"):
        SurfacePoint.from_ray(points, triangles, np.array([1.0, 0.0, 0.1]), np.array([0.0, 0.0, -1.0]))
