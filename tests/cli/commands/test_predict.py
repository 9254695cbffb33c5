import json
import shutil

import cv2
import numpy as np
import pytest

from laploop.cli.main import main
from laploop.perception.data.frame_store import FrameStore
from laploop.studies.depth.evaluation import EstimatorCache

SMALL = ["--train-tissues", "0", "--val-tissues", "0", "--test-tissues", "1", "--frames-per-tissue", "2", "--workers", "1"]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    out = tmp_path_factory.mktemp("data") / "out"
    assert main(["synthesize", *SMALL, "--seed", "3", "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def images(dataset):
    """The frames as 8 bits, the first also as 16, and a picture without stripes."""
    folder = dataset.parent / "images"
    folder.mkdir()
    store = FrameStore.open(dataset / "frames.zarr")
    for index in range(2):
        cv2.imwrite(str(folder / f"{index:04d}.png"), store.image(index))
    cv2.imwrite(str(folder / "deep.tif"), store.image(0).astype(np.uint16) * 257)
    cv2.imwrite(str(folder / "plain.png"), np.full((256, 256), 128, np.uint8))
    return folder


@pytest.fixture(scope="module")
def out(dataset, images):
    folder = dataset.parent / "predicted"
    arguments = ["--images", str(images), "--calibration", str(dataset / "scope.json"), "--model", "compact"]
    assert main(["predict", *arguments, "--out", str(folder)]) == 0
    return folder


def test_depth_of_a_data_sets_frames_is_evaluates_to_the_bit(dataset, out):
    store = FrameStore.open(dataset / "frames.zarr")
    for index in range(2):
        estimator = EstimatorCache(["compact"]).all(store.rig(index))["compact"]
        expected = estimator.estimate(store.image(index))
        np.testing.assert_array_equal(np.load(out / f"{index:04d}_raw.npy"), expected.depth_mm)
        masked = np.where(expected.valid, expected.depth_mm, np.nan)
        np.testing.assert_array_equal(np.load(out / f"{index:04d}_depth.npy"), masked)
    np.testing.assert_array_equal(np.load(out / "deep_raw.npy"), np.load(out / "0000_raw.npy"))


def test_summary_has_a_line_a_picture(out):
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["command"], summary["pictures"], summary["without_stripes"]) == ("predict", 4, 1)
    lines = {line["image"]: line for line in summary["images"]}
    assert list(lines) == ["0000.png", "0001.png", "deep.tif", "plain.png"]
    assert lines["plain.png"]["valid_fraction"] == 0.0
    assert lines["plain.png"]["median_depth_mm"] is None
    assert "no stripes" in lines["plain.png"]["note"]
    for name in ("0000.png", "0001.png"):
        depth = np.load(out / f"{name[:4]}_depth.npy")
        assert lines[name]["valid_fraction"] == pytest.approx(np.isfinite(depth).mean())
        assert lines[name]["median_depth_mm"] == pytest.approx(np.nanmedian(depth), abs=1e-3)
        assert lines[name]["estimate_ms"] > 0.0
    assert {entry.name for entry in out.iterdir()} == {*summary["artefacts"], "summary.json"}
    assert len(summary["artefacts"]) == 4 * 9


def test_bad_input_ends_with_status_2_before_anything_is_written(dataset, images, tmp_path, capsys):
    there, scope = str(images), str(dataset / "scope.json")
    mixed = shutil.copytree(images, tmp_path / "mixed")
    (mixed / "zz.png").write_bytes((images / "0000.png").read_bytes()[:2000])
    (tmp_path / "empty").mkdir()
    (tmp_path / "scope.json").write_text(scope)
    for changes, message in (
        (["--images", str(mixed), "--calibration", scope], "zz.png"),
        (["--images", str(tmp_path / "empty"), "--calibration", scope], "allowed: 1 or more"),
        (["--images", str(tmp_path / "none"), "--calibration", scope], "folder of images not found"),
        (["--images", there, "--calibration", str(tmp_path / "none.json")], "calibration not found"),
        (["--images", there, "--calibration", str(tmp_path / "scope.json")], "a JSON file that can be read"),
        (["--images", there, "--calibration", scope, "--model", "oracle"], "metric depth"),
        (["--images", there, "--calibration", scope, "--bits", "8"], "9 to 16"),
        (["--images", there, "--calibration", scope, "--bits", "12"], "deep.tif"),
    ):
        assert main(["predict", *changes, "--out", str(tmp_path / "new")]) == 2
        assert message in capsys.readouterr().err
        assert not (tmp_path / "new").exists()
    assert main(["predict", "--images", there, "--calibration", scope, "--out", there]) == 2
    assert "another folder than that of the images" in capsys.readouterr().err
