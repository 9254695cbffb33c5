"""`laploop phantom`."""

from laploop.cli.main import main


def test_organ_is_written_whole(tmp_path, capsys):
    out = tmp_path / "new" / "organ.ply"
    assert main(["phantom", "--family", "lobes", "--seed", "1", "--out", str(out)]) == 0
    assert "triangles" in capsys.readouterr().out
    assert [path.name for path in out.parent.iterdir()] == ["organ.ply"]


def test_bad_input_leaves_nothing(tmp_path, capsys):
    assert main(["phantom", "--family", "liver", "--out", str(tmp_path / "organ.stl")]) == 2
    assert main(["phantom", "--family", "lobes", "--out", str(tmp_path / "organ.step")]) == 2
    assert "unknown family of phantoms 'liver'" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
