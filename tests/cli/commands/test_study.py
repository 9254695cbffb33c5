import json
import re

import pytest

from laploop.cli.main import main
from laploop.studies.sweeps.report import can_report

SWEEP = """
title = "A try"
seeds = 1
metrics = ["total_rms_mm", "depth_age_mean_ms"]
[base]
task = "track"
perception = "oracle"
seconds = 0.2
settle_s = 0.1
[vary]
"loop.timing.service.latency_ms" = [0, 40.0]
"""

pytestmark = pytest.mark.filterwarnings("ignore:no report.html")


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    (folder / "own.toml").write_text(SWEEP)
    command = ["study", str(folder / "own.toml"), "--out", str(folder / "out")]
    assert main(command) == 0
    return folder, command


def test_a_users_sweep_leaves_tables_figures_and_a_summary(done):
    folder, _ = done
    summary = json.loads((folder / "out" / "summary.json").read_text())
    assert summary["command"] == "study"
    assert summary["repeat"].split()[:2] == ["laploop", "study"]
    assert [line["values"] for line in summary["conditions"]] == [
        {"loop.timing.service.latency_ms": 0},
        {"loop.timing.service.latency_ms": 40.0},
    ]
    assert {"episodes.parquet", "table.csv", "table.md", "sweep.toml", "total_rms_mm.png"} <= set(summary["artefacts"])
    assert all((folder / "out" / name).is_file() for name in summary["artefacts"])
    assert (folder / "out" / "sweep.toml").read_text() == SWEEP
    assert ("report.html" in summary["artefacts"]) == can_report()


def test_the_same_command_repeats_nothing_and_writes_the_same_tables(done, monkeypatch):
    folder, command = done
    names = ("table.csv", "table.md", "episodes.parquet")
    before = [(folder / "out" / name).read_bytes() for name in names]
    monkeypatch.setattr("laploop.envs.episode.run_episode", lambda *_, **__: pytest.fail("an episode was run again"))
    assert main(command) == 0
    assert [(folder / "out" / name).read_bytes() for name in names] == before


@pytest.mark.skipif(not can_report(), reason="needs the extra report")
def test_the_report_asks_no_other_machine(done):
    folder, _ = done
    page = (folder / "out" / "report.html").read_text()
    assert not re.findall(r"<(?:script|link|img|iframe)[^>]+(?:src|href)=", page)
    assert page.count("Plotly.newPlot(") >= 2
    assert "laploop study" in page


def test_a_bad_sweep_is_bad_input_in_one_line_and_makes_no_folder(tmp_path, capsys):
    (tmp_path / "own.toml").write_text(SWEEP.replace("[0, 40.0]", "[]"))
    assert main(["study", str(tmp_path / "own.toml"), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert "own.toml, line 11: loop.timing.service.latency_ms is []" in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()
