import json

import pytest
from minari import MinariDataset

from laploop.cli.main import main
from laploop.envs.tasks.reach import ReachEnv

FAST = ["--fidelity", "fast", "--noise", "0.05"]


@pytest.fixture
def short(monkeypatch):
    """A reach that is solved after 0.4 s."""
    monkeypatch.setattr(ReachEnv, "ended_by", lambda env: "success" if env.loop.now_ns >= 400_000_000 else None)


def test_demonstrations_are_written_told_and_replayed(short, tmp_path, capsys):
    assert main(["demonstrate", *FAST, "--episodes", "2", "--format", "lerobot", "--out", str(tmp_path)]) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert (summary["command"], summary["episodes"], summary["success_rate"]) == ("demonstrate", 2, 1.0)
    assert summary["config"]["demonstration"]["environment"]["fidelity"] == "fast"
    assert (tmp_path / "lerobot" / "meta" / "info.json").is_file()
    assert not (tmp_path / ".dataset.partial").exists()
    capsys.readouterr()

    out = tmp_path / "replayed"
    assert main(["replay", str(tmp_path), "--episode", "1", "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "frames that differ" in printed
    assert "this code" in printed
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["frames"], summary["differing_frames"], summary["same_code"]) == (10, 0, True)
    assert (out / "recording.rrd").stat().st_size > 10_000


def test_a_data_set_for_minari_is_written_below_the_working_folder(short, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["demonstrate", *FAST, "--episodes", "1", "--out", "runs/shown"]) == 0
    assert len(MinariDataset(tmp_path / "runs" / "shown" / "minari" / "laploop" / "reach-v0" / "data")) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["runs"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["demonstrate", "--task", "rech", "--out", "OUT"], "did you mean 'reach'"),
        (["demonstrate", "--randomisation", "wid", "--out", "OUT"], "did you mean 'wide'"),
        (["demonstrate", "--latency-ms", "150", "--randomisation", "narrow", "--out", "OUT"], "leave latency_ms out"),
        (["demonstrate", "--format", "hdf5", "--out", "OUT"], "minari, lerobot"),
        (["demonstrate", "--episodes", "0", "--out", "OUT"], "1 to 1000000"),
        (["demonstrate", "--format", "lerobot", "--decision-period-ms", "48", "--out", "OUT"], "whole number a second"),
        (["demonstrate", "--decision-period-ms", "41", "--out", "OUT"], "multiple of the control period"),
        (["replay", "OUT"], "does not hold demonstrations"),
        (["replay"], "must be given"),
    ],
)
def test_bad_input_is_refused_in_one_line(arguments, words, tmp_path, capsys):
    out = tmp_path / "out"
    assert main([str(out) if one == "OUT" else one for one in arguments]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.strip().splitlines()[-1].startswith("laploop ")
    assert not out.exists()
