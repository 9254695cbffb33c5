import json
import subprocess
import sys
from pathlib import Path

import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.cli.commands import run as command
from laploop.cli.main import main
from laploop.control.controllers.reach import ReachController
from laploop.envs import episode
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
    "stage_ms": {"physics", "render", "perception", "control", "record"},
}


@pytest.fixture(scope="module")
def short_run(tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "out"
    arguments = ["run", "--task", "reach", "--perception", "oracle", "--seed", "5", "--seconds", "0.3", "--motion", "both"]
    assert main([*arguments, "--out", str(out)]) == 0
    return out


def test_run_leaves_recording_figure_and_summary_and_nothing_else(short_run):
    assert sorted(path.name for path in short_run.iterdir()) == ["episode.png", "recording.rrd", "summary.json"]
    assert (short_run / "episode.png").read_bytes().startswith(b"\x89PNG")
    assert (short_run / "recording.rrd").read_bytes().startswith(b"RRF2")


def test_summary_has_every_promised_key(short_run):
    summary = json.loads((short_run / "summary.json").read_text())
    assert summary.keys() >= SUMMARY_KEYS
    for group, keys in SUMMARY_GROUPS.items():
        assert summary[group].keys() >= keys, group
    assert (summary["command"], summary["seed"], summary["motion"]) == ("run", 5, "both")
    assert (summary["success"], summary["terminated_by"]) == (False, "time")
    assert summary["config"]["episode"]["seconds"] == 0.3


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
        ("--perception", "eyes", "unknown perception 'eyes'; available: compact, "),
        ("--actuation", "rocket", "unknown actuation 'rocket'; available: ideal, ur5-cb, ur5-e"),
        ("--motion", "wobbling", "available: beating, both, breathing, still"),
        ("--prediction", "magic", "unknown prediction 'magic'; available: none, rate, rhythms"),
        ("--optics", "rosy", "unknown optics 'rosy'; available: ideal, paper, worst"),
        ("--trocar", "rusty", "unknown trocar 'rusty'; available: dry, lubricated, none"),
        ("--weights", "nowhere.safetensors", "weights not found at nowhere.safetensors"),
        ("--seconds", "-1", "seconds is -1.0; allowed: above 0"),
        ("--seed", "-1", "seed is -1; allowed: an integer from 0"),
    ],
)
def test_value_that_is_not_allowed_is_named_with_what_is(tmp_path, capsys, option, value, message):
    assert main(["run", option, value, "--out", str(tmp_path / "out")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("arguments", [["--seed", "abc"], ["--seed", "1.5"], ["--sed", "1"], []])
def test_option_that_cannot_be_read_is_bad_input(tmp_path, capsys, arguments):
    out = ["--out", str(tmp_path / "out")] if arguments else []
    assert main(["run", *arguments, *out]) == 2
    error = capsys.readouterr().err
    assert (arguments[-1] if arguments else "--out") in error
    assert not (tmp_path / "out").exists()


def test_folder_that_cannot_be_written_is_refused_before_the_episode(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(command, "run_episode", lambda *_: pytest.fail("the episode was run"))
    (tmp_path / "file").write_text("")
    assert main(["run", "--perception", "oracle", "--out", str(tmp_path / "file" / "out")]) == 2
    assert "cannot write" in capsys.readouterr().err


def test_interrupted_run_leaves_nothing(tmp_path, capsys, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "run_episode", interrupted)
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

    def run_episode(config, recorder, progress):
        controller = Breaks(Rig.from_optics(ScopeOptics()))
        return episode.run_episode(config, recorder, progress, controller=controller)

    monkeypatch.setattr(command, "run_episode", run_episode)
    out = tmp_path / "out"
    out.mkdir()
    (out / "summary.json").write_text("of an earlier run")
    assert main(["run", "--perception", "oracle", "--out", str(out)]) == status
    assert [path.name for path in out.iterdir()] == ["recording.rrd"]
    assert capsys.readouterr().err.endswith(f"run: {line}; the recording up to then is kept in {out}/recording.rrd\n")
    verify = [str(Path(sys.executable).with_name("rerun")), "rrd", "verify", str(out / "recording.rrd")]
    subprocess.run(verify, check=True, capture_output=True)  # noqa: S603 - installed with us
