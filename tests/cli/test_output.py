import dataclasses
import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from laploop.cli.main import main
from laploop.cli.output import OutputFolder, plain
from laploop.errors import MissingFileError, OutputError


@dataclasses.dataclass(frozen=True)
class Config:
    seed: int = 3
    out: Path = Path("somewhere")


def names(folder):
    return sorted(entry.name for entry in folder.iterdir())


def test_summary_tells_command_config_seed_versions_time_and_artefacts(tmp_path):
    with OutputFolder(tmp_path / "new" / "folder", "run") as folder:
        folder.write_text("table.csv", "a,b\n")
        folder.write_summary({"success": True}, config=Config(), seed=3)
    summary = json.loads((tmp_path / "new" / "folder" / "summary.json").read_text())
    assert summary["command"] == "run"
    assert summary["config"] == {"seed": 3, "out": "somewhere"}
    assert summary["seed"] == 3
    assert {"python", "laploop", "mujoco", "torch"} <= summary["versions"].keys()
    assert summary["wall_s"] >= 0.0
    assert summary["artefacts"] == ["table.csv"]
    assert summary["success"] is True


@pytest.mark.parametrize("where", ["a_file", "a_file/below", "/proc/laploop/x", "x" * 256, "~nosuchuser/x"])
def test_folder_that_cannot_be_written_is_refused_before_any_work(tmp_path, where):
    (tmp_path / "a_file").write_text("")
    with pytest.raises(OutputError, match="cannot write"):
        OutputFolder(where if where.startswith("~") else tmp_path / where, "run")
    assert names(tmp_path) == ["a_file"]


def test_artefact_gets_its_name_only_when_it_is_whole(tmp_path):
    with OutputFolder(tmp_path, "run") as folder, folder.artefact("big.bin") as path:
        path.write_bytes(b"half")
        assert not (tmp_path / "big.bin").exists()
    assert names(tmp_path) == ["big.bin"]


def test_failing_command_keeps_what_was_complete_and_nothing_else(tmp_path):
    def command():
        with OutputFolder(tmp_path, "run") as folder:
            folder.write_text("done.txt", "done")
            with folder.artefact("half.txt") as path:
                path.write_text("half")
                raise KeyError

    with pytest.raises(KeyError):
        command()
    assert names(tmp_path) == ["done.txt"]


def test_folder_made_in_vain_is_removed_with_its_parents(tmp_path):
    with pytest.raises(KeyError), OutputFolder(tmp_path / "a" / "b", "run"):
        raise KeyError
    assert names(tmp_path) == []


def test_folder_that_was_there_before_stays(tmp_path):
    with pytest.raises(KeyError), OutputFolder(tmp_path, "run"):
        raise KeyError
    assert tmp_path.is_dir()


def test_old_summary_goes_with_the_first_new_artefact(tmp_path):
    (tmp_path / "summary.json").write_text("{}")
    with pytest.raises(KeyError), OutputFolder(tmp_path, "run"):
        raise KeyError
    assert names(tmp_path) == ["summary.json"]
    with OutputFolder(tmp_path, "run") as folder:
        folder.write_text("new.txt", "new")
    assert names(tmp_path) == ["new.txt"]


def test_artefact_that_its_writer_keeps_on_failure_takes_the_old_summary_with_it(tmp_path):
    (tmp_path / "summary.json").write_text("{}")

    def command():
        with OutputFolder(tmp_path, "run") as folder, folder.own_artefact("recording") as path:
            path.write_text("what there is")
            raise KeyError

    with pytest.raises(KeyError):
        command()
    assert names(tmp_path) == ["recording"]


def test_artefact_that_its_writer_did_not_touch_leaves_the_old_summary(tmp_path):
    (tmp_path / "summary.json").write_text("{}")
    (tmp_path / "recording").write_text("earlier")
    with pytest.raises(KeyError), OutputFolder(tmp_path, "run") as folder, folder.own_artefact("recording"):
        raise KeyError
    assert names(tmp_path) == ["recording", "summary.json"]


def test_what_a_killed_command_left_half_written_is_removed_at_the_next_start(tmp_path):
    for name in (".recording.rrd.partial", ".laploop.lock", "mine.partial"):
        (tmp_path / name).write_text("half")
    with OutputFolder(tmp_path, "run") as folder:
        folder.write_text("new.txt", "new")
    assert names(tmp_path) == ["mine.partial", "new.txt"]


def test_folder_is_locked_while_it_is_open(tmp_path):
    with OutputFolder(tmp_path, "run"), pytest.raises(OutputError, match="in use by another laploop command"):
        OutputFolder(tmp_path, "trials")
    with OutputFolder(tmp_path, "trials"):
        pass
    assert names(tmp_path) == []


def test_further_processes_of_one_training_share_its_folder(tmp_path, monkeypatch):
    with OutputFolder(tmp_path, "train"):
        monkeypatch.setenv("LOCAL_RANK", "1")
        with OutputFolder(tmp_path, "train") as folder:
            folder.write_text("new.txt", "new")
        with pytest.raises(OutputError, match="in use"):
            OutputFolder(tmp_path, "run")


@pytest.mark.parametrize("command", ["run", "trials"])
def test_second_command_on_a_folder_is_refused_in_one_line_until_the_first_is_gone(tmp_path, capsys, command):
    options = [command, "--perception", "oracle", "--seconds", "60", "--out", str(tmp_path)]
    first = subprocess.Popen([Path(sys.executable).with_name("laploop"), *options], stderr=subprocess.DEVNULL)  # noqa: S603
    try:
        while not (tmp_path / ".laploop.lock").exists():
            assert first.poll() is None
            time.sleep(0.05)
        before = names(tmp_path)
        assert main(options) == 2
        assert capsys.readouterr().err.count("\n") == 1
        assert set(before) <= set(names(tmp_path))
    finally:
        first.kill()
        first.wait()
    with OutputFolder(tmp_path, command):
        assert not list(tmp_path.glob(".*.partial"))


def test_full_disk_is_an_output_error_that_names_the_artefact(tmp_path):
    with (
        pytest.raises(OutputError, match=r"table\.csv: No space left"),
        OutputFolder(tmp_path, "run") as folder,
        folder.artefact("table.csv"),
    ):
        raise OSError(28, "No space left on device")
    assert names(tmp_path) == []


def test_errors_that_are_not_about_the_artefact_pass_through(tmp_path):
    with (
        pytest.raises(MissingFileError, match="weights"),
        OutputFolder(tmp_path, "run") as folder,
        folder.artefact("table.csv"),
    ):
        raise MissingFileError("weights", "w.safetensors", "train them")


def test_plain_makes_json_of_everything():
    value = {"a": np.float64(1.5), "b": np.arange(2), 3: (float("nan"), float("inf")), "p": Path("x"), "c": Config(), "n": None}
    expected = {"a": 1.5, "b": [0, 1], "3": [None, None], "p": "x", "c": {"seed": 3, "out": "somewhere"}, "n": None}
    assert plain(value) == expected
    json.dumps(plain(value), allow_nan=False)
