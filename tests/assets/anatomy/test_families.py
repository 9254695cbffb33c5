"""Every family makes closed, varied shapes of the size that fills the view; the held-out ones are marked."""

import sys

import numpy as np
import pytest

from laploop.assets.anatomy.distance_grid import DistanceGrid
from laploop.assets.anatomy.families.registry import FAMILIES, family_named, family_names
from laploop.errors import InvalidValueError, UnknownNameError


@pytest.fixture(scope="module", params=FAMILIES)
def two(request):
    return [FAMILIES[request.param].build(np.random.default_rng(seed)) for seed in (0, 1)]


def _volume(mesh):
    corners = mesh.points[mesh.triangles]
    return float(np.linalg.det(corners - corners[0, 0]).sum() / 6.0)


def test_shapes_are_closed_and_oriented_outwards(two):
    for mesh in two:
        a, b = mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).T.astype(np.int64)
        # Every side is that of one triangle, and in the other direction that of one more.
        forwards, backwards = np.sort(a * len(mesh.points) + b), np.sort(b * len(mesh.points) + a)
        assert (np.diff(forwards) > 0).all()
        np.testing.assert_array_equal(forwards, backwards)
        assert _volume(mesh) > 5e-7  # m^3


def test_shapes_fill_the_view_with_fine_triangles(two):
    for mesh in two:
        width = np.ptp(mesh.points[:, :2], axis=0)
        assert 0.060 < width.min() <= width.max() < 0.240
        assert np.ptp(mesh.points[:, 2]) < 0.110
        corners = mesh.points[mesh.triangles]
        up = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 0.0
        middle = np.abs(corners[..., :2]).max(axis=(1, 2)) < 0.03
        edges = np.linalg.norm(corners[up & middle, 1] - corners[up & middle, 0], axis=1)
        assert np.quantile(edges, 0.9) < 1.4e-3
        assert mesh.parts.shape == (len(mesh.triangles),)


def test_another_seed_is_another_shape(two):
    one, other = two
    assert one.points.shape != other.points.shape or np.abs(one.points - other.points).max() > 1e-3


def test_same_seed_is_the_same_shape_to_the_bit():
    for name in ("bowel-loops", "omentum"):
        one, other = (FAMILIES[name].build(np.random.default_rng(5)) for _ in range(2))
        np.testing.assert_array_equal(one.points, other.points)
        np.testing.assert_array_equal(one.triangles, other.triangles)


def test_five_families_are_held_out_and_eight_are_learned_from():
    assert family_names(held_out=True) == ("colon", "omentum", "mesentery", "stomach", "foreign-bodies")
    assert len(family_names(held_out=False)) == 8
    with pytest.raises(UnknownNameError, match="did you mean 'stomach'"):
        family_named("stomac")


def test_sphere_has_its_volume_and_a_carved_one_less():
    grid = DistanceGrid([-0.01] * 3, [0.01] * 3, 5e-4)
    grid.add_spheres(np.zeros((1, 3)), np.array([0.008]))
    whole = _volume(grid.surface(smoothing=0.1))
    assert whole == pytest.approx(4.0 / 3.0 * np.pi * 0.008**3, rel=0.02)
    grid.carve(grid.tube(np.array([[0.0, 0.0, 0.0]]), 0.004))
    assert _volume(grid.surface(smoothing=0.1)) == pytest.approx(whole * (1.0 - 0.125), rel=0.02)


def test_missing_extra_is_named_with_the_way_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "skimage", None)
    monkeypatch.setitem(sys.modules, "skimage.measure", None)
    with pytest.raises(InvalidValueError, match=r"skimage.*pip install 'laploop\[mesh\]'"):
        FAMILIES["stomach"].build(np.random.default_rng(0))
