import numpy as np
import trimesh

from laploop.assets.phantom_import.self_intersection import crossing_triangles


def dome():
    mesh = trimesh.creation.icosphere(subdivisions=3)
    mesh.vertices[:, 2] = np.maximum(mesh.vertices[:, 2], 0.0)
    # The lower half, pressed flat, is the underside.
    mesh.apply_scale((40.0, 40.0, 25.0))
    return mesh


def box(x=60.0, y=50.0, z=20.0, at=(0.0, 0.0, 0.0)):
    mesh = trimesh.creation.box((x, y, z))
    mesh.apply_translation(at)
    return mesh


def spiked_box():
    mesh = box().subdivide()
    # One vertex of the bottom pulled out through the top.
    low = np.flatnonzero(np.isclose(mesh.vertices[:, 2], -10.0) & (np.abs(mesh.vertices[:, :2]) < 1.0).all(axis=1))
    mesh.vertices[low, 2] = 15.0
    return mesh


def test_crossing_and_overlapping_triangles_are_found_and_touching_ones_are_not():
    flat = [[0, 0, 0], [10, 0, 0], [0, 10, 0]]
    cases = {
        "pierced": ([[2, 2, -1], [2, 2, 1], [3, 3, 1]], True),
        "in one plane": ([[1, 1, 0], [11, 1, 0], [1, 11, 0]], True),
        "corner on the face": ([[2, 2, 0], [2, 2, 5], [4, 4, 5]], False),
        "above": ([[2, 2, 0.001], [9, 2, 0.001], [2, 9, 0.001]], False),
        "beside, in one plane": ([[10, 10, 0], [5.1, 5.1, 0], [10, 5, 0]], False),
    }
    for name, (other, expected) in cases.items():
        found = crossing_triangles(np.array([*flat, *other], float), np.array([[0, 1, 2], [3, 4, 5]]), tolerance=1e-4)
        assert (found is not None) == expected, name
    # Neighbours at an edge: a hinge is fine however sharp, folded flat is not.
    for height, expected in ((5.0, False), (0.5, False), (0.0, True)):
        points = np.array([*flat, [1.0, 8.0, height]])
        found = crossing_triangles(points, np.array([[0, 1, 2], [1, 0, 3]]), tolerance=1e-4)
        assert (found is not None) == expected, height


def test_crossing_does_not_depend_on_the_place_in_space():
    rng = np.random.default_rng(0)
    two_through_each_other = trimesh.util.concatenate([dome(), trimesh.creation.icosphere(2, 30.0)])
    for mesh, expected in ((two_through_each_other, True), (trimesh.creation.icosphere(3, 40.0), False), (spiked_box(), True)):
        for _ in range(3):
            points = mesh.vertices @ np.linalg.qr(rng.standard_normal((3, 3)))[0] + rng.uniform(-100.0, 100.0, 3)
            assert (crossing_triangles(points, mesh.faces, tolerance=1e-4) is not None) == expected
