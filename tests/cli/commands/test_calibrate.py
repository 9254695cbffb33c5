import json
from dataclasses import replace

import pytest

from laploop.cli.main import EXIT_BAD_INPUT, EXIT_OK, main
from laploop.perception.calibration.calibration_file import load_calibration, load_record
from laploop.studies.calibration import run


def test_calibrate_writes_a_file_that_can_be_loaded_and_tells_the_residuals(tmp_path, monkeypatch):
    calibrate_bench = run.calibrate_bench

    def coarsely(config, report):
        # A reference camera of a quarter of the pixels, which take most of the time.
        reference = replace(config.bench.reference, sampling="2x2")
        return calibrate_bench(replace(config, bench=replace(config.bench, reference=reference)), report)

    monkeypatch.setattr(run, "calibrate_bench", coarsely)
    arguments = ["calibrate", "--views", "5", "--no-hand-eye", "--seed", "2", "--out", str(tmp_path)]
    assert main(arguments) == EXIT_OK
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["command"] == "calibrate"
    assert summary["reprojection_error_px"]["scope"] < 0.3
    assert summary["reprojection_error_px"]["reference"] < 0.3
    assert summary["true_residual"]["stereo"]["rotation_deg"] < 0.2
    assert summary["true_residual"]["hand_eye"] is None
    assert {entry.name for entry in tmp_path.iterdir()} == {*summary["artefacts"], "summary.json"}
    record = load_record(tmp_path / "calibration.json")
    assert record.hand_eye is None
    assert record.projector.error_turns == pytest.approx(summary["projector_error_turns"], rel=1e-9)
    stereo = load_calibration(tmp_path / "calibration.json")
    assert (stereo.reference.intrinsics.width, stereo.scope.intrinsics.width) == (1224, 256)


def test_too_few_views_leave_nothing_behind(tmp_path, capsys):
    folder = tmp_path / "new"
    assert main(["calibrate", "--views", "4", "--out", str(folder)]) == EXIT_BAD_INPUT
    assert "views is 4; allowed: an integer, 5 to 1000" in capsys.readouterr().err
    assert not folder.exists()
