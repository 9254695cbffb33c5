import json

import pytest

from laploop.cli.main import main
from laploop.perception.data.frame_store import FrameStore

SMALL = ["--train-tissues", "1", "--val-tissues", "1", "--test-tissues", "1", "--frames-per-tissue", "1", "--workers", "1"]
SMALL += ["--optics.width", "32", "--optics.height", "32"]


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    out = tmp_path_factory.mktemp("synthesize") / "data"
    assert main(["synthesize", *SMALL, "--out", str(out)]) == 0
    return out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--ranges.working-distance-m", "0.1", "10"], "working_distance_m"),
        (["--ranges.tilt-rad", "3"], "tilt_rad is 3.0"),
        (["--ranges.press-m", "0", "1"], "press_m"),
        (["--ranges.tool-clearance-m", "0.09"], "tool_clearance_m"),
        (["--ranges.hover-m", "0.04", "0.01"], "hover_m is (0.04, 0.01); allowed: low <= high"),
        (["--scope-ranges.baseline-m", "0.003", "0.5"], "baseline_m"),
        (["--frames-per-tissue", "0"], "frames_per_tissue is 0"),
        (["--seed", "-1"], "seed"),
    ],
)
def test_bad_options_are_refused_before_a_data_set_is_made(tmp_path, capsys, options, message):
    assert main(["synthesize", *SMALL, *options, "--out", str(tmp_path / "out")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_verify_tells_a_good_data_set_from_a_spoilt_one(out, capsys):
    assert main(["synthesize", "--verify", str(out)]) == 0
    assert "3 of 3 frames done, nothing wrong" in capsys.readouterr().out
    chunk = out / "frames.zarr" / "depth_mm" / "c.1.0.0"
    kept = chunk.read_bytes()
    chunk.write_bytes(kept[:-1])
    try:
        assert main(["synthesize", "--verify", str(out)]) == 1
    finally:
        chunk.write_bytes(kept)
    assert "frame 1: depth_mm of frame 1 of" in capsys.readouterr().out


def test_what_was_rendered_before_is_kept(out):
    FrameStore.open(out / "frames.zarr").verify(range(3))
    (out / "frames.zarr" / "checksum" / "c.1.0").unlink()
    assert main(["synthesize", *SMALL, "--out", str(out)]) == 0
    assert json.loads((out / "summary.json").read_text())["frames_rendered_now"] == 1


def test_folder_is_needed(capsys):
    assert main(["synthesize", *SMALL]) == 2
    assert "--out" in capsys.readouterr().err
