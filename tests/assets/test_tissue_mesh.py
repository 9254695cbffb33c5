import numpy as np
import pytest
import trimesh

from laploop.assets.tissue_config import TissueShape
from laploop.assets.tissue_mesh import mean_top_height, solid_from_tetrahedra, solid_mesh
from laploop.assets.tissue_shape import height_field
from laploop.errors import InvalidValueError

SHAPE = TissueShape()


def tissue(seed, shape=SHAPE):
    return height_field(shape, np.random.default_rng(seed))


def test_mesh_is_a_closed_solid_with_surface_turned_outwards():
    height = tissue(0)
    mesh = solid_mesh(SHAPE, height)
    corners = mesh.points[mesh.tetrahedra]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6.0
    assert volumes.min() > 0.0
    surface = mesh.surface_points[mesh.triangles]
    # With the flat bottom at z = 0 left out, the divergence theorem for (0, 0, z) still gives the whole volume.
    normals = 0.5 * np.cross(surface[:, 1] - surface[:, 0], surface[:, 2] - surface[:, 0])
    flux = np.sum(normals[:, 2] * surface[:, :, 2].mean(axis=1))
    np.testing.assert_allclose(flux, volumes.sum(), rtol=1e-9)
    sides = slice(mesh.top_triangle_count, None)
    assert np.all(np.sum(normals[sides, :2] * surface[sides].mean(axis=1)[:, :2], axis=1) > 0.0)


def test_every_edge_of_the_surface_but_the_bottom_rim_has_two_triangles():
    mesh = solid_mesh(SHAPE, tissue(1))
    edges = np.sort(mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, counts = np.unique(edges, axis=0, return_counts=True)
    assert counts.max() == 2
    rim = mesh.surface_points[unique[counts == 1]]
    assert np.all(rim[..., 2] == 0.0)


def test_top_vertices_come_first_and_are_the_height_field():
    height = tissue(2)
    mesh = solid_mesh(SHAPE, height)
    top = mesh.surface_points[: SHAPE.samples**2]
    np.testing.assert_array_equal(top[:, 2], height.ravel())
    assert mesh.triangles[: mesh.top_triangle_count].max() == SHAPE.samples**2 - 1


def test_height_field_of_another_size_is_refused():
    with pytest.raises(InvalidValueError, match="height field"):
        solid_mesh(SHAPE, np.ones((5, 5)))


def box(x=60.0, y=50.0, z=20.0, at=(0.0, 0.0, 0.0)):
    mesh = trimesh.creation.box((x, y, z))
    mesh.apply_translation(at)
    return mesh


def test_shape_under_an_overhang_does_not_count_as_top():
    # A wide slab on a narrow foot, as tetrahedra around the middle of each box.
    points, tetrahedra = [], []
    for part in (box(0.02, 0.02, 0.01, (0, 0, 0.005)), box(0.06, 0.06, 0.01, (0, 0, 0.03))):
        start = len(points)
        points += [*part.vertices, part.vertices.mean(axis=0)]
        tetrahedra += [[*(start + face), start + len(part.vertices)] for face in part.faces]
    mesh = solid_from_tetrahedra(np.array(points), np.array(tetrahedra))
    top = mesh.surface_points[mesh.triangles[: mesh.top_triangle_count]]
    assert len(top) == 2
    np.testing.assert_allclose(top[..., 2], 0.035, atol=1e-12)
    assert mean_top_height(mesh) == pytest.approx(0.035)
