import numpy as np
import pytest

from laploop.envs.recording.rerun_scene import VertexNormals


def test_vertex_normals_of_a_tilted_square_are_those_of_its_plane():
    tilt = 0.3
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, tilt], [0, 1, tilt]], dtype=np.float32)
    normals = VertexNormals(np.array([[0, 1, 2], [0, 2, 3]]), 4)(points)
    expected = np.array([0.0, -tilt, 1.0]) / np.hypot(tilt, 1.0)
    assert normals == pytest.approx(np.tile(expected, (4, 1)), abs=1e-6)  # float32
