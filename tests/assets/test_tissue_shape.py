"""Every seed makes a different, plausible, well-formed tissue."""

import numpy as np
import pytest

from laploop.assets.tissue_config import TissueShape
from laploop.assets.tissue_mesh import solid_mesh
from laploop.assets.tissue_shape import height_field
from laploop.errors import InvalidValueError

SHAPE = TissueShape()
SEEDS = range(12)


def tissue(seed, shape=SHAPE):
    return height_field(shape, np.random.default_rng(seed))


def test_same_seed_gives_the_same_bits():
    np.testing.assert_array_equal(tissue(3), tissue(3))


def test_two_seeds_differ():
    # Millimetres: far more than any rounding.
    assert np.abs(tissue(3) - tissue(4)).mean() > 1e-3


@pytest.mark.parametrize("seed", SEEDS)
def test_heights_and_slopes_are_those_of_folded_bowel(seed):
    height = tissue(seed)
    assert height.max() <= SHAPE.height_m + 1e-12
    assert height.min() > 0.003
    inside = height[7:-7, 7:-7]
    # Folds: at least a lobe's height between crest and crease.
    assert np.ptp(inside) > SHAPE.lobe_height_m
    slope = np.degrees(np.arctan(np.hypot(*np.gradient(inside, SHAPE.spacing_m))))
    assert np.mean(slope < 40.0) > 0.4
    assert np.mean(slope > 60.0) < 0.02


def test_mesh_is_a_closed_solid_with_surface_turned_outwards():
    height = tissue(0)
    mesh = solid_mesh(SHAPE, height)
    corners = mesh.points[mesh.tetrahedra]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6.0
    assert volumes.min() > 0.0
    surface = mesh.points[mesh.surface_vertices][mesh.triangles]
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
    rim = mesh.points[mesh.surface_vertices][unique[counts == 1]]
    assert np.all(rim[..., 2] == 0.0)


def test_top_vertices_come_first_and_are_the_height_field():
    height = tissue(2)
    mesh = solid_mesh(SHAPE, height)
    top = mesh.points[mesh.surface_vertices[: SHAPE.samples**2]]
    np.testing.assert_array_equal(top[:, 2], height.ravel())
    assert mesh.triangles[: mesh.top_triangle_count].max() == SHAPE.samples**2 - 1


@pytest.mark.parametrize(
    ("field", "value"),
    [("samples", 5), ("layers", 0), ("side_m", 0.0), ("floor_m", 0.03), ("lobe_height_m", -0.1), ("ridges", -1)],
)
def test_impossible_shapes_are_refused(field, value):
    with pytest.raises(InvalidValueError, match=field):
        TissueShape(**{field: value})


def test_height_field_of_another_size_is_refused():
    with pytest.raises(InvalidValueError, match="height field"):
        solid_mesh(SHAPE, np.ones((5, 5)))
