import csv
import json

import numpy as np
import pytest

from laploop.cli.main import main
from laploop.envs.episode import EpisodeConfig
from laploop.errors import InvalidValueError, UnknownNameError
from laploop.studies.timing import bench
from laploop.studies.timing.bench import BenchConfig
from laploop.studies.timing.bench_result import Stage
from laploop.studies.timing.machine import describe_machine

STAGES = {
    "physics step, free",
    "physics step, in contact",
    "kinematics refresh",
    "control tick",
    "control tick: targeting",
    "control tick: inverse kinematics",
    "control tick: prediction",
    "control tick: kinematics, QP, prediction",
    "control tick alone: prediction",
    "control tick alone: kinematics, QP, prediction",
    "stripe frame",
    "depth: oracle",
    "depth: phase",
    "recorder frame",
    "reference capture, 2x2",
    "reprojection, full cloud",
}
SLOW_STAGES = {"reference capture, 2x2", "reprojection, full cloud"}


def test_stage_gives_the_percentiles_in_milliseconds():
    stage = Stage.of("stripe frame", np.linspace(0.0, 0.1, 1001))
    assert (stage.p5_ms, stage.p50_ms, stage.p95_ms, stage.p99_ms) == pytest.approx((5.0, 50.0, 95.0, 99.0))
    assert (stage.calls, stage.limit_ms, stage.limit_p99_ms) == (1001, 20.0, None)


def test_a_limit_of_the_slowest_hundredth_is_told_apart_from_one_of_the_median():
    stage = Stage.of("control tick alone: prediction", [0.0003] * 100)
    assert (stage.limit_ms, stage.limit_p99_ms) == (None, 1.2)


@pytest.mark.parametrize("wrong", [{"calls": 1}, {"episodes": 0}, {"seconds": 0.0}])
def test_numbers_out_of_range_are_refused(wrong):
    with pytest.raises(InvalidValueError, match=next(iter(wrong))):
        BenchConfig(**wrong)


def test_unknown_estimator_is_refused():
    with pytest.raises(UnknownNameError, match=r"available: compact, .*oracle, phase"):
        BenchConfig(perception="eyes")


def test_machine_is_described_without_names_of_hosts_or_users():
    machine = describe_machine()
    assert machine.keys() == {
        "cpu",
        "logical_cores",
        "usable_cores",
        "memory_gib",
        "system",
        "python",
        "gpu",
        "load_1min",
    }
    assert machine["memory_gib"] > 0.1
    assert 1 <= machine["usable_cores"] <= machine["logical_cores"]


def test_command_measures_every_stage_and_the_loop(tmp_path, monkeypatch):
    # A second a call each.
    monkeypatch.setattr(bench, "_REFERENCE_CALLS", 2)
    arguments = ["bench", "--calls", "20", "--episodes", "1", "--estimators", "oracle", "phase", "--perception", "oracle"]
    assert main([*arguments, "--seconds", "3", "--out", str(tmp_path / "out")]) == 0
    out = tmp_path / "out"
    assert sorted(path.name for path in out.iterdir()) == ["bench.csv", "bench.json", "bench.md", "summary.json"]
    written = json.loads((out / "bench.json").read_text())
    assert {stage["name"] for stage in written["stages"]} == STAGES
    assert all(stage["calls"] >= (2 if stage["name"] in SLOW_STAGES else 20) for stage in written["stages"])
    assert all(0.0 < stage["p5_ms"] <= stage["p50_ms"] <= stage["p99_ms"] for stage in written["stages"])
    assert written["loop"]["real_time_factor"]["median"] > 0.0
    assert written["episodes"][0]["seed"] == EpisodeConfig().seed
    assert written["machine"]["usable_cores"] >= 1
    with (out / "bench.csv").open(newline="") as stream:
        assert {row["name"] for row in csv.DictReader(stream)} == STAGES
    markdown = (out / "bench.md").read_text()
    assert "| stripe frame | 20 |" in markdown
    assert "of real time without a recording" in markdown
