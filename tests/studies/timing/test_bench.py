import csv
import json
from pathlib import Path

import numpy as np
import pytest

from laploop.cli.main import main
from laploop.envs.episode import EpisodeConfig
from laploop.errors import InvalidValueError, UnknownNameError
from laploop.studies.timing import stage_times
from laploop.studies.timing.bench_config import BenchConfig
from laploop.studies.timing.bench_result import Stage
from laploop.studies.timing.machine import describe_machine

STAGES = {
    "physics step, free",
    "physics step, in contact",
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


@pytest.mark.parametrize("wrong", [{"calls": 1}, {"episodes": 0}, {"seconds": 0.0}, {"rounds": 0}, {"steps": 0}])
def test_numbers_out_of_range_are_refused(wrong):
    with pytest.raises(InvalidValueError, match=next(iter(wrong))):
        BenchConfig(**wrong)


def test_fidelities_and_observations_are_chosen_among_what_there_is():
    with pytest.raises(InvalidValueError, match="fidelities"):
        BenchConfig(fidelities=())
    with pytest.raises(UnknownNameError, match=r"observations.*depth_compact, depth_oracle, state, stripes"):
        BenchConfig(observations=("smell",))


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


def test_bad_paths_are_refused_before_any_work(tmp_path, capsys):
    out = tmp_path / "out"
    for option, path, message in (
        ("--against", tmp_path / "nowhere", "allowed: the folder of another checkout of the project"),
        ("--against", tmp_path, "give the top folder of a checkout of the project"),
        ("--fetch", tmp_path / "python", "give the bin/python of an environment with gymnasium-robotics"),
    ):
        assert main(["bench", option, str(path), "--out", str(out)]) == 2
        assert message in capsys.readouterr().err
        assert not out.exists()


def test_command_measures_every_stage_and_the_loop_beside_another_checkout(tmp_path, monkeypatch):
    # A second a call each.
    monkeypatch.setattr(stage_times, "_REFERENCE_CALLS", 2)
    arguments = ["bench", "--calls", "20", "--episodes", "1", "--estimators", "oracle", "phase", "--perception", "oracle"]
    arguments += ["--rounds", "1", "--steps", "2", "--fidelities", "full", "--observations", "state", "--vectors", "1"]
    # This very checkout is as good as another.
    arguments += ["--against", str(Path(__file__).parents[3])]
    assert main([*arguments, "--seconds", "3", "--out", str(tmp_path / "out")]) == 0
    out = tmp_path / "out"
    names = ["against.json", "bench.csv", "bench.json", "bench.md", "summary.json"]
    assert sorted(path.name for path in out.iterdir()) == names
    written = json.loads((out / "bench.json").read_text())
    assert {stage["name"] for stage in written["stages"]} == STAGES
    assert all(stage["calls"] >= (2 if stage["name"] in SLOW_STAGES else 20) for stage in written["stages"])
    assert all(0.0 < stage["p5_ms"] <= stage["p50_ms"] <= stage["p99_ms"] for stage in written["stages"])
    assert written["loop"]["real_time_factor"]["median"] == written["real_time_factor"]["full"] > 0.0
    assert written["episodes"][0]["seed"] == EpisodeConfig().seed
    assert written["machine"]["usable_cores"] >= 1
    per_second = written["env_steps_per_s"]["full"]["state"]["single"]
    assert written["env_steps_per_s"]["full"]["state"]["vector_1"] > 0.0
    assert sum(written["step_ms"]["full"]["state"].values()) == pytest.approx(1e3 / per_second)
    assert set(written["reset_ms"]["full"]) == {"new", "cached"}
    assert written["memory_mb"]["full"] > 100.0
    against = json.loads((out / "against.json").read_text())
    for key in ("env_steps_per_s", "real_time_factor", "reset_ms", "physics_ms", "capture_ms", "memory_mb"):
        leaf = against[key]["full"]
        while "ratio" not in leaf:
            leaf = next(iter(leaf.values()))
        # The same on both sides, but for the load of the machine.
        assert 0.1 < leaf["ratio"] < 10.0
        assert leaf["other_fidelity"] == "full"
    with (out / "bench.csv").open(newline="") as stream:
        assert {row["name"] for row in csv.DictReader(stream)} == STAGES
    markdown = (out / "bench.md").read_text()
    assert "| stripe frame | 20 |" in markdown
    assert "of real time without a recording" in markdown
    assert "In turns with another checkout" in markdown
