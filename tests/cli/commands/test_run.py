import json
import subprocess
import sys
from pathlib import Path

import pytest
from pyarrow import parquet

from laploop.assets.scope_optics import ScopeOptics
from laploop.cli.main import main
from laploop.configuration import from_plain
from laploop.control.controllers.reach import ReachController
from laploop.envs import episode
from laploop.envs.episode_config import EpisodeConfig
from laploop.errors import InfeasibleError
from laploop.perception.geometry import Rig

SUMMARY_KEYS = {
    "command",
    "config",
    "seed",
    "versions",
    "wall_s",
    "task",
    "perception",
    "motion",
    "success",
    "terminated_by",
    "sim_s",
    "real_time_factor",
    "frames",
    "depth_mae_mm",
    "depth_valid_fraction",
}
SUMMARY_GROUPS = {
    "target_error_mm": {"mean", "p95", "final"},
    "rcm_error_mm": {"camera_max", "tool_max"},
    "contact_force_n": {"max"},
    "port_force_n": {"camera_max", "tool_max"},
    "limits": {"joint_speed_share", "command_acceleration_share", "shaft_room_mm", "wall_room_mm", "collision_steps"},
    "depth_age_ms": {"mean", "p99"},
    "stage_ms": {"physics", "capture", "render", "perception", "wait", "control", "record"},
}


@pytest.fixture(scope="module")
def short_run(tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "out"
    arguments = ["run", "--task", "reach", "--perception", "oracle", "--seed", "5", "--seconds", "0.3", "--motion", "both"]
    assert main([*arguments, "--out", str(out)]) == 0
    return out


def test_run_leaves_recording_figure_tables_and_summary_and_nothing_else(short_run):
    names = sorted(path.name for path in short_run.iterdir())
    assert names == ["episode.png", "recording.rrd", "summary.json", "ticks.parquet", "timing.csv"]
    assert (short_run / "episode.png").read_bytes().startswith(b"\x89PNG")
    assert (short_run / "recording.rrd").read_bytes().startswith(b"RRF2")


def test_summary_has_every_promised_key(short_run):
    summary = json.loads((short_run / "summary.json").read_text())
    assert summary.keys() >= SUMMARY_KEYS
    for group, keys in SUMMARY_GROUPS.items():
        assert summary[group].keys() >= keys, group
    assert (summary["command"], summary["seed"], summary["motion"]) == ("run", 5, "both")
    assert (summary["success"], summary["terminated_by"]) == (False, "time")
    assert summary["config"]["task"]["max_seconds"] == 0.3
    assert from_plain(EpisodeConfig, summary["config"]) == EpisodeConfig.of(
        perception="oracle", seed=5, seconds=0.3, motion="both"
    )


@pytest.mark.parametrize("options", [["--perception", "oracle"], ["--task", "track", "--actuation", "ur5-cb", "--seed", "4"]])
def test_a_summary_repeats_its_run_to_the_same_bits(tmp_path, options):
    first, second = tmp_path / "first", tmp_path / "second"
    latency = ["--loop.latency.kind", "lognormal", "--loop.kinematic-errors.hand-eye-rad", "0.002"]
    assert main(["run", *options, *latency, "--seconds", "0.25", "--no-rerun", "--out", str(first)]) == 0
    assert main(["run", "--config", str(first / "summary.json"), "--no-rerun", "--out", str(second)]) == 0
    one, other = (json.loads((out / "summary.json").read_text()) for out in (first, second))
    # What the wall clock says is all that may differ.
    for name in ("wall_s", "real_time_factor", "stage_ms"):
        del one[name], other[name]
    assert one == other


def test_a_measured_run_is_repeated_by_its_traces_to_the_same_bits(tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    run = ["run", "--perception", "oracle", "--seconds", "0.25", "--no-rerun", "--seed", "4"]
    measured = ["--loop.timing.service.kind", "measured", "--loop.timing.compute.kind", "measured"]
    assert main([*run, *measured, "--out", str(first)]) == 0
    traces = ["--latency-trace", str(first / "service_trace.csv"), "--compute-trace", str(first / "compute_trace.csv")]
    assert main([*run, *traces, "--out", str(second)]) == 0
    assert (first / "timing.csv").read_text() == (second / "timing.csv").read_text()
    assert parquet.read_table(first / "ticks.parquet").equals(parquet.read_table(second / "ticks.parquet"))
    # Seven frames, of 0 to 240 ms.
    assert len((first / "timing.csv").read_text().splitlines()) == 1 + 7
    assert not (second / "service_trace.csv").exists()


def test_the_times_are_written_as_a_trace_where_that_is_wanted(tmp_path, capsys):
    run = ["run", "--perception", "oracle", "--seconds", "0.1", "--no-rerun", "--out", str(tmp_path / "out")]
    assert main([*run, "--trace-out", str(tmp_path / "trace.json")]) == 0
    assert json.loads((tmp_path / "trace.json").read_text())["traceEvents"]
    assert main([*run, "--trace-out", str(tmp_path / "trace.txt")]) == 2
    assert "trace.txt'; allowed: the path of a .json file" in capsys.readouterr().err


def test_results_are_shown_on_the_standard_output(tmp_path, capsys):
    assert main(["run", "--perception", "oracle", "--seconds", "0.1", "--no-rerun", "--out", str(tmp_path / "out")]) == 0
    out = capsys.readouterr().out
    assert "no success: ended by time" in out
    assert f"written to {tmp_path / 'out'}" in out
    assert not (tmp_path / "out" / "recording.rrd").exists()


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--task", "dance", "unknown task 'dance'; available: look, palpate, reach, scan, track"),
        ("--perception", "eyes", "unknown estimator 'eyes'; available: compact, "),
        ("--actuation", "rocket", "--actuation is 'rocket'; allowed: ideal, ur5-cb, ur5-e"),
        ("--motion", "wobbling", "--motion is 'wobbling'; allowed: still, breathing, beating, both"),
        ("--prediction", "magic", "unknown prediction 'magic'; available: none, rate, rhythms"),
        ("--optics", "rosy", "--optics is 'rosy'; allowed: ideal, paper, worst"),
        ("--trocar", "rusty", "--trocar is 'rusty'; allowed: none, lubricated, dry"),
        ("--weights", "nowhere.safetensors", "weights not found at nowhere.safetensors"),
        ("--seconds", "-1", "seconds is -1.0; allowed: above 0"),
        ("--seed", "-1", "seed is -1; allowed: an integer, at least 0"),
    ],
)
def test_value_that_is_not_allowed_is_named_with_what_is(tmp_path, capsys, option, value, message):
    assert main(["run", option, value, "--out", str(tmp_path / "out")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--seed", "abc"], "--seed is 'abc'; allowed: INT"),
        (["--seed", "1.5"], "--seed is '1.5'; allowed: INT"),
        (["--seconds"], "--seconds needs a value: FLOAT"),
        (["--sed", "1"], "unknown option --sed; did you mean --seed?"),
        (["track"], "unexpected 'track'; every value follows the name of its option"),
        (["--camera-hz", "50"], "unknown option --camera-hz; did you mean --loop.camera-hz?"),
        (["--loop.camera_hs", "50"], "unknown option --loop.camera_hs; did you mean --loop.camera-hz?"),
        (["--loop.latency", "50"], "--loop.latency is a table; its fields: --loop.timing.service.kind, --loop.timing.service."),
        (["--loop.camera-hz"], "--loop.camera-hz needs a value: 0.5 to 1000"),
        (["--loop.camera-hz", "fast"], "task.loop.camera_hz is 'fast'; allowed: 0.5 to 1000"),
        (["--loop.camera-hz", "30"], "task.loop.camera_hz is 30.0; allowed: a period of whole physics steps of 2 ms"),
        (["--loop.device", "tpu"], "task.loop.device is 'tpu'; allowed: cpu, cuda, or a number behind it as in cuda:0"),
        (["--loop.latency.kind", "norm"], "unknown kind of loop.timing.service 'norm'; did you mean 'normal'?"),
        (["--loop.timing.service.sigma", "1"], "unknown field 'loop.timing.service.sigma'; available: kind, latency_ms"),
        (["--loop.timing.capacity", "3"], "task.loop.timing.capacity is 3; allowed: 1 with the queue newest-wins"),
        (["--loop.timing.exposure-ms", "41"], "timing.exposure_ms is 41.0; allowed: at most the camera period, 40 ms"),
        (["--loop.faults", "x"], "task.loop.faults.0 is 'x'"),
    ],
)
def test_option_that_cannot_be_read_is_bad_input_in_one_line(tmp_path, capsys, arguments, message):
    assert main(["run", *arguments, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.startswith("laploop run: ")
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_the_folder_must_be_given(capsys):
    assert main(["run"]) == 2
    assert capsys.readouterr().err == "laploop run: --out must be given\n"
    assert main(["run", "--loop.camera-hz", "50"]) == 2
    assert capsys.readouterr().err == "laploop run: --out must be given\n"
    assert main(["run", "--otu", "somewhere"]) == 2
    assert capsys.readouterr().err == "laploop run: unknown option --otu; did you mean --out?\n"


def test_folder_that_cannot_be_written_is_refused_before_the_episode(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(episode, "run_episode", lambda *_, **__: pytest.fail("the episode was run"))
    (tmp_path / "file").write_text("")
    assert main(["run", "--perception", "oracle", "--out", str(tmp_path / "file" / "out")]) == 2
    assert "cannot write" in capsys.readouterr().err


def test_interrupted_run_leaves_nothing(tmp_path, capsys, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(episode, "run_episode", interrupted)
    assert main(["run", "--perception", "oracle", "--out", str(tmp_path / "out")]) == 130
    assert capsys.readouterr().err.endswith("laploop run: interrupted\n")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("error", "status", "line"),
    [
        (KeyboardInterrupt(), 130, "interrupted"),
        (InfeasibleError("no command holds the trocar"), 1, "no command holds the trocar"),
    ],
)
def test_episode_that_breaks_off_keeps_its_recording_and_says_so(tmp_path, capsys, monkeypatch, error, status, line):
    class Breaks(ReachController):
        ticks = 0

        def command(self, state):
            self.ticks += 1
            if self.ticks == 10:
                raise error
            return super().command(state)

    whole = episode.run_episode

    def run_episode(config, recorder, progress, **more):
        return whole(config, recorder, progress, **more, controller=Breaks(Rig.from_optics(ScopeOptics())))

    monkeypatch.setattr(episode, "run_episode", run_episode)
    out = tmp_path / "out"
    out.mkdir()
    (out / "summary.json").write_text("of an earlier run")
    assert main(["run", "--perception", "oracle", "--out", str(out)]) == status
    assert [path.name for path in out.iterdir()] == ["recording.rrd"]
    assert capsys.readouterr().err.endswith(f"run: {line}; the recording up to then is kept in {out}/recording.rrd\n")
    verify = [str(Path(sys.executable).with_name("rerun")), "rrd", "verify", str(out / "recording.rrd")]
    subprocess.run(verify, check=True, capture_output=True)  # noqa: S603 - installed with us
