import numpy as np
import pytest
import trimesh

from laploop.errors import InvalidValueError, MissingFileError
from laploop.perception.data.point_cloud import read_cloud


@pytest.fixture
def points():
    return np.random.default_rng(0).uniform(-80.0, 600.0, (50, 3)).astype(np.float32)


def write_ply(path, points, **options):
    path.write_bytes(trimesh.PointCloud(points).export(file_type="ply", **options))
    return path


def test_ply_comes_back_in_millimetres(tmp_path, points):
    np.testing.assert_array_equal(read_cloud(write_ply(tmp_path / "a.ply", points), "mm"), points)
    np.testing.assert_allclose(read_cloud(write_ply(tmp_path / "m.PLY", 1e-3 * points), "m"), points, atol=1e-4)


def test_text_ply_of_another_program_is_read(tmp_path, points):
    lines = "\n".join(" ".join(f"{value:.9g}" for value in point) + " 7 8 9" for point in points)
    header = "ply\nformat ascii 1.0\nelement vertex 50\nproperty double x\nproperty double y\nproperty double z\n"
    header += "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n"
    (tmp_path / "a.ply").write_text(header + lines + "\n")
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.ply", "mm"), points)


def test_organised_npz_loses_what_the_camera_did_not_see(tmp_path, points):
    grid = points.reshape(5, 10, 3).copy()
    grid[0, 0] = np.nan
    grid[1, 1, 2] = np.inf
    grid[2, 2] = 0.0
    np.savez(tmp_path / "a.npz", xyz=grid, rgba=np.zeros((5, 10, 4), np.uint8))
    kept = np.delete(points, [0, 11, 22], axis=0)
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.npz", "mm"), kept)


def test_what_is_no_cloud_is_named(tmp_path, points):
    whole = write_ply(tmp_path / "whole.ply", points).read_bytes()
    (tmp_path / "short.ply").write_bytes(whole[:200])
    (tmp_path / "other.ply").write_text("not a cloud")
    (tmp_path / "other.npz").write_text("not a cloud")
    (tmp_path / "cloud.xyz").write_text("0 0 1")
    np.savez(tmp_path / "named.npz", points=points)
    np.savez(tmp_path / "flat.npz", xyz=points[:, :2])
    np.savez(tmp_path / "objects.npz", xyz=np.array([None, 1]))
    np.savez(tmp_path / "nothing.npz", xyz=np.full((4, 3), np.nan))
    for name, message in (
        ("short.ply", "a PLY or NPZ file that can be read|numbers"),
        ("other.ply", "a PLY file"),
        ("other.npz", "an NPZ file"),
        ("cloud.xyz", ".ply, .npz"),
        ("named.npz", r"\['points'\]; allowed: among them xyz"),
        ("flat.npz", r"shape \(50, 2\)'; allowed: numbers"),
        ("objects.npz", "a PLY or NPZ file that can be read"),
        ("nothing.npz", "0; allowed: 1 or more"),
    ):
        with pytest.raises(InvalidValueError, match=message) as error:
            read_cloud(tmp_path / name, "mm")
        assert name in str(error.value)
    with pytest.raises(MissingFileError, match="point cloud not found"):
        read_cloud(tmp_path / "missing.ply", "mm")
