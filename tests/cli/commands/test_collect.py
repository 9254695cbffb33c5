import json
import shutil

import numpy as np
import pytest

from laploop.cli.dataset import dataset_path
from laploop.cli.main import main
from laploop.perception.calibration.calibration_file import save_calibration
from laploop.perception.calibration.results import CameraCalibration, StereoCalibration
from laploop.perception.data.pair_store import PairStore
from laploop.perception.reprojection import BrownDistortion
from laploop.studies.scenes.optical_bench import OpticalBench

SMALL = ["--pairs", "3", "--tissues", "3", "--workers", "1", "--seed", "2"]
SMALL += ["--bench.scope.width", "64", "--bench.scope.height", "64", "--bench.reference.sampling", "4x4"]
SMALL += ["--tissue.cells", "4", "4", "--tissue.shape.samples", "31"]


@pytest.fixture(scope="module")
def calibration(tmp_path_factory):
    bench = OpticalBench()

    def camera(intrinsics):
        poses = np.stack([np.eye(4)] * 5)
        return CameraCalibration(
            intrinsics=intrinsics, distortion=BrownDistortion(), view_errors_px=(0.0,) * 5, camera_from_board=poses
        )

    path = tmp_path_factory.mktemp("calibration") / "calibration.json"
    k = bench.rig.camera.from_fov(width=64, height=64, fov_rad=bench.scope.fov_rad)
    stereo = StereoCalibration(
        scope=camera(k),
        reference=camera(bench.reference.intrinsics),
        scope_from_reference=bench.scope_from_reference,
        view_errors_px=(0.0,) * 5,
    )
    save_calibration(path, stereo)
    return path


@pytest.fixture(scope="module")
def out(tmp_path_factory, calibration):
    out = tmp_path_factory.mktemp("collect") / "data"
    assert main(["collect", *SMALL, "--calibration", str(calibration), "--out", str(out)]) == 0
    return out


def test_folder_holds_the_data_set_its_card_and_a_summary(out):
    assert dataset_path(out) == out / "pairs.zarr"
    summary = json.loads((out / "summary.json").read_text())
    assert summary["command"] == "collect"
    assert summary["pairs_collected_now"] == 3
    assert summary["statistics"]["pairs"] == {"train": 1, "val": 1, "test": 1}
    assert json.loads((out / "statistics.json").read_text()) == summary["statistics"]
    assert "# Data card" in (out / "card.md").read_text()
    for figure in ("examples.png", "statistics.png"):
        assert figure in summary["artefacts"]
        assert (out / figure).read_bytes().startswith(b"\x89PNG")


def test_same_command_again_collects_nothing_anew(out, calibration, tmp_path):
    out = shutil.copytree(out, tmp_path / "copy")
    before = PairStore.open(out / "pairs.zarr").frame(1)
    assert main(["collect", *SMALL, "--calibration", str(calibration), "--out", str(out)]) == 0
    assert json.loads((out / "summary.json").read_text())["pairs_collected_now"] == 0
    for name, values in vars(PairStore.open(out / "pairs.zarr").frame(1)).items():
        np.testing.assert_array_equal(values, getattr(before, name), err_msg=name)


def test_verify_tells_a_good_data_set_from_a_spoilt_one(out, capsys):
    assert main(["collect", "--verify", str(out)]) == 0
    assert "3 of 3 pairs done, nothing wrong" in capsys.readouterr().out
    done = out / "pairs.zarr" / "checksum" / "c.1.0"
    kept = done.read_bytes()
    done.unlink()
    try:
        assert main(["collect", "--verify", str(out)]) == 1
    finally:
        done.write_bytes(kept)
    assert "pair 1: not done" in capsys.readouterr().out


def test_verify_refuses_a_data_set_whose_configuration_is_gone(out, tmp_path, capsys):
    path = tmp_path / "pairs.zarr"
    shutil.copytree(out / "pairs.zarr", path)
    content = json.loads((path / "zarr.json").read_text())
    del content["attributes"]["config"]
    (path / "zarr.json").write_text(json.dumps(content))
    assert main(["collect", "--verify", str(path)]) == 2
    assert "its attributes are not those that were written" in capsys.readouterr().err


def test_bad_input_ends_with_status_2_and_a_message(out, calibration, tmp_path, capsys):
    there = ["--calibration", str(calibration), "--out", str(out)]
    for arguments, message in (
        (["--pairs", "3"], "--out"),
        (["--verify", str(tmp_path / "nothing")], "laploop collect"),
        ([*SMALL, "--pairs", "4", *there], "another configuration"),
        ([*SMALL, "--split-tissues", "1", "1", "2", "--out", str(tmp_path / "new")], "add up to the 3 tissues"),
        ([*SMALL, "--engine", "slurm", "--out", str(tmp_path / "new")], "ray"),
        ([*SMALL, "--out", "/proc/laploop"], "cannot write"),
    ):
        assert main(["collect", *arguments]) == 2
        assert message in capsys.readouterr().err
    assert not (tmp_path / "new").exists()
