import numpy as np
import pytest

from laploop.envs.sensors.tracing import primitives


def volume(surface):
    points, triangles = surface
    a, b, c = (points[triangles[:, i]] for i in range(3))
    return np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0


@pytest.mark.parametrize(
    ("surface", "expected"),
    [
        (primitives.sphere(0.01), 4.0 / 3.0 * np.pi * 0.01**3),
        (primitives.ellipsoid(0.01, 0.02, 0.03), 4.0 / 3.0 * np.pi * 6e-6),
        (primitives.capsule(0.003, 0.05), np.pi * 0.003**2 * 0.1 + 4.0 / 3.0 * np.pi * 0.003**3),
        (primitives.cylinder(0.0025, 0.1), np.pi * 0.0025**2 * 0.2),
        (primitives.box(0.01, 0.02, 0.03), 8.0 * 6e-6),
    ],
)
def test_primitives_are_closed_and_face_outwards(surface, expected):
    # A sag of 4 um on a radius of 2.5 mm costs 0.3 % of the volume.
    assert volume(surface) == pytest.approx(expected, rel=0.005)
    points, triangles = surface
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    keys = np.round(points, 9)
    _, welded = np.unique(keys, axis=0, return_inverse=True)
    _, counts = np.unique(np.sort(welded.ravel()[edges], axis=1), axis=0, return_counts=True)
    assert (counts == 2).all()
