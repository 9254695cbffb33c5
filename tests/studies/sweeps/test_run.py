import os
import sys
from importlib import import_module
from importlib.util import find_spec

import pytest
from pyarrow import parquet

from laploop.cli.main import main
from laploop.errors import InvalidValueError, SimulationError
from laploop.studies.episodes.trials import failed_row
from laploop.studies.sweeps.analyses.findings import analyse
from laploop.studies.sweeps.engine import Engine
from laploop.studies.sweeps.run import run_sweep, write_parquet
from laploop.studies.sweeps.sweep_file import read_sweep
from laploop.studies.sweeps.table import lines_of, table_csv, table_markdown


def fake_row(episode):
    """Stand in for an episode: an error that grows with latency."""
    latency_ms = episode.task.loop.timing.pipeline.latency_ms
    row = failed_row(episode.seed, SimulationError("none"))
    error = 0.01 * latency_ms + 0.1 * episode.seed
    return {**row, "error": None, "success": True, "metrics": {"total_rms_mm": error, "force_max_n": 0.0}}


DEADLY = """
import os, signal
from pathlib import Path
from laploop.errors import SimulationError
from laploop.studies.episodes.trials import failed_row

def deadly_row(episode):
    mark = Path(__file__).with_name("mark")
    if episode.seed == 1 or not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return {**failed_row(episode.seed, SimulationError("none")), "error": None}
"""
"""Dies in a worker: always for seed 1, and once for another; a module of its own, which new processes can import."""


def test_rows_come_in_the_sweeps_order_and_become_tables(sweep_file, tmp_path):
    sweep = read_sweep(sweep_file())
    counts = []
    outcomes = run_sweep(sweep, tmp_path, Engine(), counts.append, run=fake_row)
    assert counts == list(range(9))
    assert [one.values("total_rms_mm") for one in outcomes] == [[0.0, 0.1], [0.0, 0.1], [0.5, 0.6], [0.5, 0.6]]
    lines, findings = lines_of(sweep, outcomes), analyse(sweep, outcomes)
    assert lines[2]["metrics"]["total_rms_mm"]["value"]["mean"] == pytest.approx(0.55)
    assert lines[2]["metrics"]["total_rms_mm"]["difference"]["low"] == pytest.approx(0.5)
    header, *body = table_csv(lines).splitlines()
    assert header.startswith("condition,group,loop.timing.pipeline.latency_ms,prediction,episodes")
    assert len(body) == 4
    assert "0.55 [0.5, 0.6]; +0.5 [+0.5, +0.5]" in table_markdown(sweep, lines, findings)
    first, _ = findings.charts
    assert [(line.name, line.x) for line in first.series] == [("none", [0.0, 50.0]), ("rate", [0.0, 50.0])]
    assert findings.sentences[0] == (
        "None: with loop.timing.pipeline.latency_ms from 0 to 50, the RMS error goes from 0.05 to 0.55 mm, "
        "a difference of +0.5 [+0.5, +0.5]."
    )
    write_parquet(outcomes, tmp_path / "episodes.parquet")
    table = parquet.read_table(tmp_path / "episodes.parquet").to_pylist()
    assert len(table) == 8
    assert (table[5]["seed"], table[5]["prediction"], table[5]["total_rms_mm"]) == (1, "none", 0.6)


def test_a_stopped_sweep_goes_on_without_repeating_an_episode(sweep_file, tmp_path):
    sweep, seen = read_sweep(sweep_file()), []

    def run(episode):
        if len(seen) == 3:
            seen.append(None)
            raise KeyboardInterrupt
        seen.append(episode)
        return fake_row(episode)

    with pytest.raises(KeyboardInterrupt):
        run_sweep(sweep, tmp_path, Engine(), run=run)
    outcomes = run_sweep(sweep, tmp_path, Engine(), run=run)
    assert len(seen) == 9
    (tmp_path / "other").mkdir()
    assert outcomes == run_sweep(sweep, tmp_path / "other", Engine(), run=fake_row)


def test_an_address_is_a_clusters(sweep_file):
    with pytest.raises(InvalidValueError, match="address"):
        Engine(address="127.0.0.1:6379")


def test_conditions_share_equal_episodes(sweep_file, tmp_path):
    sweep, seen = read_sweep(sweep_file(more='\n[[conditions]]\nname = "one"\n[[conditions]]\nname = "two"\n')), []

    def run(episode):
        seen.append(episode)
        return fake_row(episode)

    assert len(run_sweep(sweep, tmp_path, Engine(), run=run)) == 8
    assert len(seen) == 8


def test_a_dead_worker_is_replaced_once_and_then_reported(sweep_file, tmp_path, monkeypatch):
    (tmp_path / "deadly.py").write_text(DEADLY)
    monkeypatch.syspath_prepend(tmp_path)
    deadly_row = import_module("deadly").deadly_row
    sweep = read_sweep(sweep_file(("[0, 50.0]", "[50.0]"), ('"none", "rate"', '"none"')), seeds=3)
    (outcome,) = run_sweep(sweep, tmp_path, Engine(workers=2), run=deadly_row)
    assert [row["error"] is None for row in outcome.rows] == [True, False, True]
    assert "died 2 times, the last time by signal 9" in outcome.rows[1]["error"]
    again = run_sweep(sweep, tmp_path, Engine(), run=fake_row)
    assert [row["error"] for row in again[0].rows] == [None, None, None]


@pytest.mark.filterwarnings("ignore:no report.html")
@pytest.mark.slow  # each worker imports everything
@pytest.mark.parametrize("engine", ["process", "ray"])
def test_workers_give_the_same_tables_as_one(sweep_file, tmp_path, engine):
    if find_spec(engine) is None and engine == "ray":
        pytest.skip("needs the extra ray")
    names = ("table.csv", "table.md", "episodes.parquet")
    for workers, folder, chosen in ((1, "one", "process"), (2, "two", engine)):
        arguments = ["study", sweep_file(), "--out", str(tmp_path / folder), "--workers", str(workers), "--engine", chosen]
        assert main(arguments) == 0
    for name in names:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


@pytest.mark.slow  # starts a cluster
@pytest.mark.skipif(find_spec("ray") is None, reason="needs the extra ray")
def test_a_dead_worker_of_a_cluster_is_reported_too(sweep_file, tmp_path, monkeypatch):
    (tmp_path / "deadly.py").write_text(DEADLY)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    deadly_row = import_module("deadly").deadly_row
    sweep = read_sweep(sweep_file(("[0, 50.0]", "[50.0]"), ('"none", "rate"', '"none"')), seeds=3)
    (outcome,) = run_sweep(sweep, tmp_path, Engine(engine="ray", workers=2), run=deadly_row)
    assert [row["error"] is None for row in outcome.rows] == [True, False, True]
    assert "worker process died 2 times" in outcome.rows[1]["error"]
