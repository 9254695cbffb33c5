"""Commands that are killed or stopped at any moment leave no process behind, and end in the same bits when they are resumed."""

import csv
import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest
from safetensors.numpy import load_file

from laploop.assets.scope_optics import ScopeOptics
from laploop.cli.main import main
from laploop.envs.sensors.reference.optics import ReferenceOptics
from laploop.perception.calibration.calibration_file import save_calibration
from laploop.perception.calibration.results import CameraCalibration, StereoCalibration
from laploop.perception.reprojection import BrownDistortion
from laploop.studies.scenes.optical_bench import OpticalBench

LAPLOOP = Path(sys.executable).with_name("laploop")
SMALL = ["--optics.width", "64", "--optics.height", "64"]
TISSUES = ["--train-tissues", "3", "--val-tissues", "1", "--test-tissues", "0", "--frames-per-tissue", "4"]

SWEEP = """
title = "Small"
seeds = 3
base = {task = "track", perception = "oracle", seconds = 0.3, settle_s = 0.1}
vary = {"loop.timing.pipeline.latency_ms" = [0, 40.0]}
"""

WORKLOADS = {
    "trials": ["trials", "--perception", "oracle", "--seconds", "0.3", "--seeds", "6", "--workers", "2"],
    "study": ["study", "SWEEP", "--workers", "2"],
    "synthesize": ["synthesize", *TISSUES, *SMALL, "--workers", "2"],
    "train": ["train", "--dataset", "FRAMES", "--epochs", "6", "--batch", "4", "--resume"],
    "train with loader workers": [
        *("train", "--model", "dual-unet", "--size", "tiny", "--dataset", "FRAMES", "--epochs", "4", "--batch", "4"),
        *("--machine.workers", "2", "--resume"),
    ],
    "collect": [
        *("collect", "--pairs", "6", "--tissues", "3", "--workers", "2", "--calibration", "CALIBRATION"),
        *("--bench.scope.width", "64", "--bench.scope.height", "64", "--bench.reference.sampling", "4x4"),
        *("--tissue.shape.samples", "31", "--tissue.cells", "4", "4"),
    ],
}
"""Each takes seconds."""
TIMES = {"collect": 5, "study": 5, "train with loader workers": 5}
"""How often each is stopped; 15 times where it says nothing."""

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """Make the files that some of the commands read."""
    folder = tmp_path_factory.mktemp("inputs")
    assert main(["synthesize", *TISSUES, *SMALL, "--out", str(folder / "frames")]) == 0
    bench = OpticalBench(scope=ScopeOptics(width=64, height=64), reference=ReferenceOptics(sampling="4x4"))
    exact = {"distortion": BrownDistortion(), "view_errors_px": (0.0,) * 5, "camera_from_board": np.stack([np.eye(4)] * 5)}
    cameras = [CameraCalibration(intrinsics=one, **exact) for one in (bench.rig.camera, bench.reference.intrinsics)]
    calibration = StereoCalibration(
        scope=cameras[0], reference=cameras[1], scope_from_reference=bench.scope_from_reference, view_errors_px=(0.0,) * 5
    )
    save_calibration(folder / "calibration.json", calibration)
    (folder / "sweep.toml").write_text(SWEEP)
    files = {"FRAMES": "frames", "CALIBRATION": "calibration.json", "SWEEP": "sweep.toml"}
    return {word: str(folder / name) for word, name in files.items()}


def start(name, inputs, out):
    """Start a command, and return when it has begun to work in its folder."""
    lock = out / ".laploop.lock"
    lock.unlink(missing_ok=True)
    command = [LAPLOOP, *(inputs.get(word, word) for word in WORKLOADS[name]), "--out", out]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)  # noqa: S603 - ours
    while not lock.exists() and process.poll() is None:
        time.sleep(0.02)
    return process


def content(out):
    """Return all that a command made whose bits do not depend on the clock."""
    found = {}
    for path in sorted(out.rglob("*")):
        place = path.relative_to(out)
        if path.parent.name == "rows" and path.is_file():
            found[place] = {**json.loads(path.read_text())["row"], "real_time_factor": None}
        elif path.name in {"table.csv", "episodes.parquet"}:
            found[place] = path.read_bytes()
        elif path.name == "log.csv":
            found[place] = [{**row, "wall_s": None} for row in csv.DictReader(path.read_text().splitlines())]
        elif path.suffix == ".safetensors" and path.stem != "checkpoint":
            found[place] = {name: tensor.tobytes() for name, tensor in load_file(path).items()}
        elif place.parts[0].endswith(".zarr") and path.is_file():
            found[place] = path.read_bytes()
    return found


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
@pytest.mark.parametrize("name", WORKLOADS)
def test_stopped_command_leaves_no_process_and_resumes_to_the_same_bits(inputs, tmp_path, name, how):
    whole, out = tmp_path / "whole", tmp_path / "out"
    process = start(name, inputs, whole)
    began = time.monotonic()
    _, error = process.communicate()
    longest_s = time.monotonic() - began
    assert process.returncode == 0, error
    rng = np.random.default_rng(how)
    stopped = 0
    while stopped < TIMES.get(name, 15):
        process = start(name, inputs, out)
        time.sleep(float(rng.uniform(0.0, longest_s)))
        family = [] if process.poll() is not None else psutil.Process(process.pid).children(recursive=True)
        process.send_signal(how)
        began = time.monotonic()
        _, error = process.communicate()
        if process.returncode == 0:
            assert content(out) == content(whole)
            shutil.rmtree(out)
            continue
        # Python has let go of the signal when it is about to end; a shell calls both 143.
        assert process.returncode in {-how, 128 + how}, error
        # A worker whose parent is killed while it starts has nobody to tell it what to do: Python's own start says so.
        assert how == signal.SIGKILL or "Traceback" not in error
        assert psutil.wait_procs(family, timeout=5.0 - (time.monotonic() - began))[1] == []
        stopped += 1
    process = start(name, inputs, out)
    _, error = process.communicate()
    assert process.returncode == 0, error
    assert content(out) == content(whole)
    assert not list(out.glob(".*"))
