"""The whole calibration of the simulated bench, from pictures, against the truth."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from laploop.envs.sensors.reference.optics import ReferenceOptics
from laploop.errors import InvalidValueError, UnknownNameError
from laploop.studies.calibration.config import CalibrationConfig
from laploop.studies.calibration.run import calibrate_bench
from laploop.studies.calibration.truth import as_dict, corners_as_csv, true_residuals, views_as_csv
from laploop.studies.scenes.optical_bench import OpticalBench


@pytest.fixture(scope="module")
def found():
    """Few views, and a reference camera of a quarter of the pixels."""
    seen = []
    bench = OpticalBench(reference=ReferenceOptics(sampling="2x2"))
    config = CalibrationConfig(views=6, seed=1, bench=bench)
    calibration = calibrate_bench(config, seen.append)
    assert seen == list(range(1, config.pictures + 1))
    return calibration


def test_few_views_already_give_a_good_calibration(found):
    residuals = true_residuals(found)
    assert found.joint.scope_error_px < 0.3
    assert found.joint.reference_error_px < 0.3
    assert found.stereo.reference.error_px < 0.3
    # Twice what twenty views have to keep.
    assert residuals.stereo.rotation_deg < 0.2
    assert residuals.stereo.translation_mm < 1.0
    assert abs(residuals.scope.fx) < 2.0  # px


def test_projector_is_found(found):
    residual = true_residuals(found).projector
    assert found.projector.error_turns < 0.01
    assert abs(residual.baseline_um) < 10.0
    assert abs(residual.roll_deg) < 0.02
    # A period is as wrong as the focal length that it is measured with; depth hardly is.
    assert abs(residual.period_ppm) < 5000.0
    assert residual.depth_rms_mm < 0.2
    assert residual.rig_depth_rms_mm < 0.2


def test_scope_on_its_arm_is_found(found):
    residual = true_residuals(found).hand_eye
    assert residual.rotation_deg < 0.1
    assert residual.translation_mm < 1.0


def test_tables_have_a_row_for_each_view_and_corner(found):
    views, corners = (table(found).splitlines() for table in (views_as_csv, corners_as_csv))
    assert len(views) == 1 + 6 * 6
    assert len(corners) == 1 + 3 * 6 * 72
    assert {line.split(",")[0] for line in views[1:]} == {"own", "pair", "factory", "card", "arm"}
    assert np.isfinite([float(line.split(",")[3]) for line in views[1:]]).all()


def test_summary_says_what_was_left_out(found):
    partly = as_dict(replace(found, projector=None, rig=None, hand_eye=None))
    assert partly["rig"] is None
    assert partly["true_residual"].hand_eye is None
    assert set(partly) == set(as_dict(found))


def test_too_few_views_are_refused_before_any_picture():
    with pytest.raises(InvalidValueError, match="views is 4; allowed: an integer, 5 to 1000"):
        CalibrationConfig(views=4)


@pytest.mark.parametrize(
    "change", [{"seed": -1}, {"own_depths_m": (0.11, 0.1)}, {"pair_depths_m": (0.1, 0.5)}, {"joint_noise_rad": 1.0}]
)
def test_impossible_configurations_are_refused(change):
    with pytest.raises(InvalidValueError, match=next(iter(change))):
        CalibrationConfig(**change)


def test_unknown_presets_are_refused():
    with pytest.raises(UnknownNameError, match="available: ideal, paper, worst"):
        OpticalBench(preset="perfect")


@pytest.mark.slow
def test_twenty_views_keep_the_limits():
    found = calibrate_bench(CalibrationConfig(views=20, seed=3, projector=False, hand_eye=False))
    residuals = true_residuals(found)
    assert found.joint.scope_error_px < 0.3
    assert found.joint.reference_error_px < 0.3
    assert residuals.stereo.rotation_deg < 0.1
    assert residuals.stereo.translation_mm < 0.5


@pytest.mark.slow
def test_two_calibrations_in_two_processes_are_equal_to_the_bit(tmp_path):
    files = []
    for number, threads in enumerate(("1", "2", "2")):
        out = tmp_path / str(number)
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": threads, "OMP_NUM_THREADS": threads}
        command = [sys.executable, "-P", "-c", "import sys; from laploop.cli.main import main; sys.exit(main(sys.argv[1:]))"]
        options = ["calibrate", "--views", "6", "--seed", "2", "--out", str(out)]
        subprocess.run([*command, *options], check=True, capture_output=True, env=environment)  # noqa: S603 - our own command
        files.append((out / "calibration.json").read_bytes())
    assert files[0] == files[1] == files[2]
