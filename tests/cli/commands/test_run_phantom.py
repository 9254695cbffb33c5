"""`laploop run --phantom FILE`."""

import json

import pytest
import trimesh

from laploop.cli.main import main


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def test_short_run_on_a_users_mesh_leaves_picture_and_summary(tmp_path):
    path, out = tmp_path / "dome.stl", tmp_path / "out"
    mesh = trimesh.creation.icosphere(subdivisions=2)
    mesh.vertices[:, 2] = mesh.vertices[:, 2].clip(min=0.0)
    mesh.apply_scale((50.0, 50.0, 25.0))
    mesh.export(path)
    arguments = ["run", "--phantom", str(path), "--perception", "oracle", "--seconds", "0.3", "--no-rerun"]
    assert main([*arguments, "--out", str(out)]) == 0
    summary = json.loads((out / "summary.json").read_text())
    assert summary["config"]["task"]["loop"]["theatre"]["tissue"]["mesh"] == str(path)
    # Millimetres: the oracle gives the exact depth, so anything else would be a surface that is not where it is seen.
    assert summary["depth_mae_mm"] < 1e-3
    assert (out / "episode.png").read_bytes().startswith(b"\x89PNG")


def test_unfit_mesh_is_bad_input_and_leaves_nothing(tmp_path, capsys):
    path, out = tmp_path / "box.obj", tmp_path / "out"
    trimesh.creation.box((0.1, 0.1, 0.03)).export(path)
    for given, message in (
        (path, "size of phantom box.obj along x is '0.1 mm'; allowed: 20 to 200 mm"),
        (tmp_path / "none.stl", "none.stl"),
        (tmp_path / "body.step", "suffix of the phantom's file is '.step'"),
    ):
        assert main(["run", "--phantom", str(given), "--perception", "oracle", "--out", str(out)]) == 2
        assert message in capsys.readouterr().err
        assert not out.exists()
