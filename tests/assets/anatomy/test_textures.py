"""Textures vary the albedo as their kind says, on vertices, a seed each."""

import numpy as np
import pytest

from laploop.assets.anatomy.anatomy_mesh import vertex_normals
from laploop.assets.anatomy.families.walls import wall
from laploop.assets.anatomy.textures import BRIGHTEST, DARKEST, TEXTURES, texture_named, texture_names
from laploop.errors import UnknownNameError


@pytest.fixture(scope="module")
def mesh():
    return wall(np.random.default_rng(0))


@pytest.mark.parametrize("name", TEXTURES)
def test_factors_are_in_bounds_and_the_seeds_own(mesh, name):
    one, same, other = (TEXTURES[name].paint(mesh, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert one.albedo_factor.shape == one.wet.shape == (len(mesh.points),)
    assert DARKEST <= one.albedo_factor.min() <= one.albedo_factor.max() <= BRIGHTEST
    np.testing.assert_array_equal(one.albedo_factor, same.albedo_factor)
    assert (name == "plain") == np.array_equal(one.albedo_factor, other.albedo_factor)


def test_blood_is_dark_and_wet_and_nothing_else_is_wet(mesh):
    for name, texture in TEXTURES.items():
        surface = texture.paint(mesh, np.random.default_rng(3))
        assert surface.wet.any() == (name == "blood")
        if name == "blood":
            assert surface.albedo_factor[surface.wet].mean() < 0.7 * surface.albedo_factor[~surface.wet].mean()


@pytest.mark.parametrize("name", ["vessels", "lattice"])
def test_vessels_cover_a_part_of_the_surface_with_sharp_rims(mesh, name):
    factor = TEXTURES[name].paint(mesh, np.random.default_rng(4)).albedo_factor
    dark = factor < 0.8 * np.median(factor)
    assert 0.005 < dark.mean() < 0.6
    # A rim is one edge of the mesh wide: much of the contrast lies between neighbours.
    step = np.abs(np.diff(factor[mesh.triangles], axis=1)).max(axis=1)
    assert np.quantile(step, 0.999) > 0.2


def test_normals_of_a_flat_wall_point_up():
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    normals = vertex_normals(points, np.array([[0, 1, 2], [0, 2, 3]]))
    np.testing.assert_allclose(normals, [[0.0, 0.0, 1.0]] * 4)


def test_two_textures_are_held_out_and_unknown_names_are_refused():
    assert texture_names(held_out=True) == ("lattice", "lesions")
    with pytest.raises(UnknownNameError, match="did you mean 'vessels'"):
        texture_named("vessel")
