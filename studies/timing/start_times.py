"""How long it takes until a command answers, or the package is there: a new Python process each time."""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from laploop.errors import WorkerError
from laploop.studies.timing.bench_config import BenchConfig
from laploop.studies.timing.interleaving import in_turns
from laploop.studies.timing.probe_process import Sample, python_path
from laploop.studies.timing.rows import Row, RowResult

_STARTS = {
    "help": "from laploop.cli.main import main; main(['--help'])",
    "help_of_run": "from laploop.cli.main import main; main(['run', '--help'])",
    "import_envs": "import laploop.envs",
}
"""Programs by the name of their row; `run` has the most options of all commands."""


@dataclass(frozen=True, kw_only=True)
class _Start:
    """A program that a fresh interpreter runs."""

    program: str
    source: Path
    """Folder that holds the package."""

    def block(self, _number: int, /) -> Sample:
        environment = {**os.environ, "PYTHONPATH": python_path(self.source)}
        begin = time.perf_counter()
        done = subprocess.run(  # noqa: S603  our own program
            [sys.executable, "-P", "-c", self.program], env=environment, capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise WorkerError(f"`{self.program}` has failed in {self.source}: {done.stderr.strip()[-500:]}")
        return {"units": 1, "wall_s": time.perf_counter() - begin}


def start_rows() -> Iterator[Row]:
    """Yield the rows of starts, `start_ms` > what is started."""
    for name, program in _STARTS.items():
        yield Row(path=("start_ms", name), measure="start", options={"program": program}, unit="ms")


def measure_starts(config: BenchConfig, source: Path, other_source: Path | None) -> list[RowResult]:
    """Measure the starts, in turns with those of another checkout if there is one.

    Args:
        config: How often to measure.
        source: Folder that holds the package to measure.
        other_source: The same of the other checkout.

    Raises:
        WorkerError: If a program fails.
    """
    sources = {"this": source} | ({} if other_source is None else {"other": other_source})
    results = []
    for row in start_rows():
        starts = {name: _Start(program=row.options["program"], source=place) for name, place in sources.items()}
        samples = in_turns(starts, config.rounds)
        results.append(RowResult(row=row, samples=samples["this"], others=samples.get("other", ())))
    return results
