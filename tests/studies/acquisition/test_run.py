import os
import signal
import subprocess
import sys
import time
from contextlib import nullcontext, suppress
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import psutil
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.tissue_config import TissueMaterial
from laploop.errors import DatasetError, InvalidValueError, MissingFileError, OutputError, SimulationError, WorkerError
from laploop.perception.calibration.calibration_file import save_calibration
from laploop.perception.data.check import check_dataset
from laploop.perception.data.datasets import open_dataset
from laploop.perception.data.frame_store import FrameStore
from laploop.perception.data.pair_store import PairStore
from laploop.perception.geometry import Rig
from laploop.studies.acquisition import run as acquisition
from laploop.studies.acquisition.run import collect_pairs


def _assert_same(path, store):
    other = PairStore.open(path)
    assert other.done().all()
    for index in range(len(store)):
        for name, values in vars(store.frame(index)).items():
            np.testing.assert_array_equal(getattr(other.frame(index), name), values, err_msg=f"{name} of pair {index}")
        assert other.metadata(index) == store.metadata(index)


def test_every_planned_pair_is_done_and_no_tissue_is_in_two_splits(store):
    assert store.done().all()
    assert store.tissue_seed.tolist() == [0, 0, 0, 1, 1, 2, 2]
    assert store.split.tolist() == [0, 0, 0, 1, 1, 2, 2]
    assert [open_dataset(store.path).indices(split).tolist() for split in ("train", "val", "test")] == [
        [0, 1, 2],
        [3, 4],
        [5, 6],
    ]


def test_distances_of_a_tissue_are_spread_over_the_range(store):
    metadata = [store.metadata(index) for index in range(len(store))]
    distances = [entry["commanded"]["working_distance_mm"] for entry in metadata]
    assert 60.0 <= distances[0] <= 60.0 + 80.0 / 3.0 <= distances[1] <= 60.0 + 160.0 / 3.0 <= distances[2] <= 140.0
    assert 60.0 <= distances[3] <= 100.0 <= distances[4] <= 140.0
    exact = [np.nanmedian(store.depth_mm(index)) for index in range(len(store))]
    # The view's middle is not the tissue's mean height: lobes and valleys are a centimetre, the stage lies 2 cm deeper.
    np.testing.assert_allclose(exact, distances, atol=25.0)


def test_reached_pose_is_the_commanded_one_within_the_repeatability(store):
    errors = []
    for index in range(len(store)):
        metadata = store.metadata(index)
        commanded, reached = (np.array(metadata[name]["world_from_stage"]) for name in ("commanded", "reached"))
        errors.append(np.abs(reached[:3, 3] - commanded[:3, 3]).max())
        assert metadata["surface_speed_mm_s"] < 0.1
        assert metadata["settle_s"] > 0.0
    assert min(errors) > 0.0
    assert max(errors) < 5.0 * 5e-6  # metres, five standard deviations


def test_reference_depth_of_a_perfect_calibration_is_the_exact_depth(store):
    for index in range(len(store)):
        difference = store.reference_depth_mm(index) - store.depth_mm(index)
        both = np.isfinite(difference) & store.lit(index)
        assert both.mean() > 0.5
        # mm: the noise of a sparse cloud is 0.1, the camera's own scale error of 0.2 % at 600 mm up to 1.2.
        assert np.median(np.abs(difference[both])) < 0.5


def test_shadows_are_seen_surfaces_inside_the_field_that_are_not_lit(store, small):
    half = small.bench.scope.mask.half_width_tan
    for index in range(len(store)):
        frame = store.frame(index)
        inside = (np.abs(frame.projector_x) <= half) & (np.abs(frame.projector_y) <= half)
        np.testing.assert_array_equal(frame.shadow, inside & ~frame.lit)
        assert not (frame.shadow & np.isnan(frame.depth_mm)).any()
    assert any(store.frame(index).shadow.any() for index in range(len(store)))


def test_mask_coordinates_are_those_of_the_exact_depth(store, small):
    rig = Rig.from_optics(small.bench.scope)
    expected = rig.projector_x(1e-3 * store.depth_mm(2).astype(np.float64))
    np.testing.assert_allclose(store.frame(2).projector_x, expected, atol=2e-6)  # tangent; single precision


def test_exposure_leaves_frames_neither_dark_nor_burnt(store):
    for index in range(len(store)):
        image = store.image(index)
        assert np.percentile(image, 99.0) > 25
        assert (image == 255).mean() < 0.05


def test_tool_is_in_view_where_it_was_planned(store):
    assert store.tool_in_view.any()
    assert not store.tool_in_view.all()
    for index in range(len(store)):
        assert (store.metadata(index)["tool"] is not None) == store.tool_in_view[index]


def test_processes_make_the_same_pairs_as_one(store, tmp_path, calibration, small):
    path = collect_pairs(replace(small, workers=2), tmp_path / "pairs", calibration=calibration)
    _assert_same(path, store)


def _reporting_to(report):
    return lambda _what, _total: nullcontext(report)


def test_pair_does_not_depend_on_those_before_it(store, tmp_path, calibration, small):
    reports = []

    class Interruption(Exception):  # noqa: N818 - stands for Ctrl-C
        pass

    def interrupt(count):
        reports.append(count)
        if count == 5:
            raise Interruption

    path = tmp_path / "pairs"
    with pytest.raises(Interruption):
        collect_pairs(small, path, calibration=calibration, progress=_reporting_to(interrupt))
    assert PairStore.open(path).count_done() == 5
    for lost in ("1", "4"):
        (path / "checksum" / f"c.{lost}.0").unlink()
    collect_pairs(small, path, calibration=calibration, progress=_reporting_to(reports.append))
    assert reports == [0, 1, 2, 3, 4, 5, 3, 4, 5, 6, 7, 7]
    _assert_same(path, store)


_SCRIPT = """
import sys
from pathlib import Path
from dataclasses import replace
from importlib.util import module_from_spec, spec_from_file_location
from laploop.studies.acquisition.run import collect_pairs
spec = spec_from_file_location("acquisition_plan", sys.argv[1])
plan = module_from_spec(spec)
spec.loader.exec_module(plan)
if __name__ == "__main__":
    config = replace(plan.SMALL, workers=int(sys.argv[4]))
    collect_pairs(config, Path(sys.argv[2]), calibration=Path(sys.argv[3]))
"""


def _start(script, path, calibration, workers):
    plan = Path(__file__).with_name("conftest.py")
    command = [sys.executable, str(script), str(plan), str(path), str(calibration), str(workers)]
    return subprocess.Popen(command, stderr=subprocess.DEVNULL)  # noqa: S603 - our own script


@pytest.mark.slow
def test_killed_collection_goes_on_to_the_same_pairs(store, tmp_path, calibration, small):
    script = tmp_path / "collect.py"
    script.write_text(_SCRIPT)
    path, rng = tmp_path / "pairs", np.random.default_rng(0)
    for workers in (1, 2, 1):
        before = PairStore.open(path).count_done() if path.exists() else 0
        process = _start(script, path, calibration, workers)
        deadline = time.monotonic() + 120.0
        while not path.exists() or PairStore.open(path).count_done() <= before:
            assert time.monotonic() < deadline
            assert process.poll() is None
            time.sleep(0.01)
        time.sleep(float(rng.uniform(0.0, 0.3)))
        process.send_signal(signal.SIGKILL)
        process.wait()
        # Workers notice the end of the main process by themselves.
        time.sleep(0.5)
        counted = PairStore.open(path).count_done()
        time.sleep(1.0)
        assert PairStore.open(path).count_done() == counted
    collect_pairs(small, path, calibration=calibration)
    _assert_same(path, store)
    assert check_dataset(PairStore.open(path)).passed


needs_ray = pytest.mark.skipif(find_spec("ray") is None, reason="needs the extra ray")
"""Ray must be imported by what starts it, which tells it where to listen."""


def _listening(pid):
    """Return the hexadecimal addresses at which a process and all that it started listen."""
    inodes = {}
    for table in ("tcp", "tcp6"):
        rows = [line.split() for line in Path("/proc/net", table).read_text().splitlines()[1:]]
        inodes |= {row[9]: row[1].partition(":")[0] for row in rows if row[3] == "0A"}
    found = set()
    for process in (psutil.Process(pid), *psutil.Process(pid).children(recursive=True)):
        with suppress(psutil.Error, OSError):
            links = [str(link.readlink()) for link in Path(f"/proc/{process.pid}/fd").iterdir()]
            found |= {inodes[link[8:-1]] for link in links if link.startswith("socket:[") and link[8:-1] in inodes}
    return found


@pytest.mark.slow
@needs_ray
def test_ray_makes_the_same_pairs_and_listens_to_this_machine_alone(store, tmp_path, calibration, monkeypatch, small):
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    addresses = set()
    path = collect_pairs(
        replace(small, engine="ray", workers=2),
        tmp_path / "pairs",
        calibration=calibration,
        progress=_reporting_to(lambda _: addresses.update(_listening(os.getpid()))),
    )
    _assert_same(path, store)
    assert os.environ["RAY_USAGE_STATS_ENABLED"] == "0"
    # 127.0.0.1, alone and as an address of IPv6, as Linux writes them.
    assert addresses == {"0100007F", "0000000000000000FFFF00000100007F"}


@pytest.fixture
def no_calibration(monkeypatch):
    def fail(*_):
        raise AssertionError("the bench is calibrated although no pair can be collected")

    monkeypatch.setattr(acquisition, "calibrate_bench", fail)


def test_missing_ray_is_an_error_that_names_the_extra_before_any_work(tmp_path, no_calibration, monkeypatch, small):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingFileError, match=r"laploop\[ray\]"):
        collect_pairs(replace(small, engine="ray"), tmp_path / "pairs")


@needs_ray
def test_cluster_that_cannot_be_reached_or_started_is_an_error_before_any_work(tmp_path, no_calibration, monkeypatch, small):
    monkeypatch.setenv("RAY_ADDRESS", "127.0.0.1:1")
    with pytest.raises(WorkerError, match=r"cannot reach the Ray cluster at 127\.0\.0\.1:1: .*refused"):
        collect_pairs(replace(small, engine="ray"), tmp_path / "pairs")
    monkeypatch.delenv("RAY_ADDRESS")

    def fail(**_):
        raise TimeoutError("no space in /dev/shm\nand more")

    monkeypatch.setattr("ray.init", fail)
    with pytest.raises(WorkerError, match=r"cannot start a Ray cluster: no space in /dev/shm$"):
        collect_pairs(replace(small, engine="ray"), tmp_path / "pairs")
    assert list(tmp_path.iterdir()) == []


def test_tissue_that_does_not_settle_is_an_error(tmp_path, calibration, small):
    wobbly = replace(small.tissue, material=TissueMaterial(young_pa=1000.0, damping_s=1e-4))
    with pytest.raises(SimulationError, match="still moves"):
        collect_pairs(replace(small, pairs=1, tissue=wobbly), tmp_path / "pairs", calibration=calibration)


def test_another_configuration_or_calibration_is_refused(store, copied, calibration, tmp_path, small, calibration_of):
    with pytest.raises(OutputError, match="different: seed"):
        collect_pairs(replace(small, seed=6), copied, calibration=calibration)
    with pytest.raises(OutputError, match="different: calibration_file_sha256"):
        collect_pairs(small, copied)
    other = tmp_path / "other.json"
    save_calibration(other, replace(calibration_of(small.bench), view_errors_px=(0.1,) * 5))
    with pytest.raises(OutputError, match="different: calibration_file_sha256"):
        collect_pairs(small, copied, calibration=other)
    _assert_same(copied, store)


def test_folder_with_a_data_set_of_another_kind_is_refused(tmp_path, calibration, small):
    path = FrameStore.create(
        tmp_path / "frames",
        optics=small.bench.scope,
        tissue_seed=np.zeros(1, np.int64),
        split=np.zeros(1, np.uint8),
        tool_in_view=np.zeros(1, bool),
        config={},
    ).path
    with pytest.raises(DatasetError, match="laploop-frames"):
        collect_pairs(small, path, calibration=calibration)


def test_calibration_that_is_missing_is_an_error_before_anything_is_written(tmp_path, small):
    with pytest.raises(MissingFileError, match="calibration"):
        collect_pairs(small, tmp_path / "pairs", calibration=tmp_path / "nothing.json")
    assert list(tmp_path.iterdir()) == []


def test_calibration_of_another_scope_is_refused_before_anything_is_written(tmp_path, calibration, small):
    bench = replace(small.bench, scope=ScopeOptics(width=96, height=64))
    with pytest.raises(InvalidValueError, match=r"calibration\.json is \(64, 64\); allowed: \(96, 64\)"):
        collect_pairs(replace(small, bench=bench), tmp_path / "pairs", calibration=calibration)
    assert list(tmp_path.iterdir()) == []


def test_bench_is_calibrated_once_where_no_calibration_is_given(tmp_path, monkeypatch, small, calibration_of):
    asked = []

    def calibrate(config, progress):
        asked.append((config.views, config.seed, config.bench.reference.region))
        return type("Found", (), {"stereo": calibration_of(config.bench)})

    monkeypatch.setattr(acquisition, "calibrate_bench", calibrate)
    config = replace(small, pairs=1, calibration_views=12)
    for _ in range(2):
        path = collect_pairs(config, tmp_path / "pairs")
    assert asked == [(12, 5, None)]
    assert check_dataset(PairStore.open(path)).passed
