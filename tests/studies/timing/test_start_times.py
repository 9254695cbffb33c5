import dataclasses

import pytest

from laploop.errors import WorkerError
from laploop.studies.timing import start_times
from laploop.studies.timing.bench_config import BenchConfig
from laploop.studies.timing.probe_process import this_source
from laploop.studies.timing.row_tables import ratios_markdown, row_medians, row_ratios
from laploop.studies.timing.start_times import measure_starts

ONCE = dataclasses.replace(BenchConfig(), rounds=1)


def test_help_comes_soon_and_both_checkouts_are_started():
    results = measure_starts(ONCE, this_source(), this_source())
    found = row_medians(results)["start_ms"]
    assert set(found) == {"help", "help_of_run", "import_envs"}
    assert 20.0 < found["help"] < found["help_of_run"] < 20_000.0
    assert set(row_ratios(results)["start_ms"]) == set(found)
    assert "start_ms > help [ms]" in ratios_markdown(results)


def test_a_program_that_fails_says_why(monkeypatch):
    monkeypatch.setattr(start_times, "_STARTS", {"broken": "raise RuntimeError('no such thing')"})
    with pytest.raises(WorkerError, match="no such thing"):
        measure_starts(ONCE, this_source(), None)
