import numpy as np
import pytest
import trimesh

from laploop.assets.phantom_import.simplification import deviation, with_fewer_triangles


def rough_slab(size, noise_mm):
    """A closed slab of 110 mm with a folded, noisy top of `size` x `size` points."""
    x, y = np.meshgrid(*[np.linspace(-55.0, 55.0, size)] * 2, indexing="ij")
    noise = noise_mm * np.random.default_rng(0).standard_normal(x.shape)
    top = np.stack([x, y, 20.0 + 4.0 * np.sin(x / 4.0) * np.cos(y / 5.0) + noise], axis=-1).reshape(-1, 3)
    rows = np.arange(size * size).reshape(size, size)
    a, b, c, d = (part.ravel() for part in (rows[:-1, :-1], rows[1:, :-1], rows[1:, 1:], rows[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    rim = np.concatenate([rows[:, 0], rows[-1, 1:], rows[-2::-1, -1], rows[0, -2:0:-1]])
    after, below = np.roll(rim, -1), size * size
    sides = [np.stack([rim, rim + below, after + below], axis=1), np.stack([rim, after + below, after], axis=1)]
    points = np.concatenate([top, top * [1.0, 1.0, 0.0]])
    return trimesh.Trimesh(points, np.concatenate([faces, faces[:, ::-1] + below, *sides]), process=False)


def test_rough_surface_stays_closed_with_a_tenth_of_its_triangles():
    given = rough_slab(150, noise_mm=0.05)
    simpler = with_fewer_triangles(given, 9000)
    assert len(simpler.faces) <= 9000
    assert simpler.is_watertight
    assert simpler.is_winding_consistent
    assert simpler.volume == pytest.approx(given.volume, rel=1e-4)
    # Four standard deviations of the noise, and the sag of triangles of 2 mm over folds of 25 mm.
    assert deviation(given, simpler) < 0.35


def test_equal_surfaces_are_simplified_equally():
    one, two = (with_fewer_triangles(rough_slab(60, noise_mm=0.02), 2000) for _ in range(2))
    np.testing.assert_array_equal(one.vertices, two.vertices)
    np.testing.assert_array_equal(one.faces, two.faces)


def test_coarse_surface_is_left_alone():
    box = trimesh.creation.box((60.0, 50.0, 20.0))
    assert with_fewer_triangles(box, 12) is box


def test_what_cannot_be_simplified_is_returned_as_far_as_it_went():
    box = trimesh.creation.box((60.0, 50.0, 20.0))
    assert len(with_fewer_triangles(box, 2).faces) > 2


def test_deviation_is_that_of_a_single_raised_point_whichever_way_it_is_asked():
    box = trimesh.creation.box((60.0, 50.0, 20.0)).subdivide().subdivide()
    points = np.array(box.vertices)
    points[np.argmin(np.linalg.norm(points - [0.0, 0.0, 10.0], axis=1)), 2] += 0.5
    raised = trimesh.Trimesh(points, box.faces)
    for one, other in ((box, raised), (raised, box)):
        assert deviation(one, other) == pytest.approx(0.5, abs=1e-6)
    assert deviation(box, box) == pytest.approx(0.0, abs=1e-6)


def test_large_triangles_do_not_hide_how_near_they_are():
    # The sides of the first are two triangles each, whose middles are far from most points of the second.
    coarse = trimesh.creation.box((60.0, 50.0, 20.0))
    assert deviation(coarse, coarse.subdivide().subdivide().subdivide()) == pytest.approx(0.0, abs=1e-6)
