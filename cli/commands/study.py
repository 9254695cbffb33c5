"""`laploop study`: the same episodes under many conditions."""

import shlex
import sys
import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field

import tyro

from laploop.cli.console import ResultTable, progress_bar
from laploop.cli.output import OutputFolder
from laploop.cli.parsing import Inlined, OutputPath, parse
from laploop.errors import LaploopNote
from laploop.studies.sweeps.engine import Engine


@dataclass(frozen=True, kw_only=True)
class StudyArguments:
    """Run a sweep: the same seeds under many conditions, told in tables, figures and a report.

    Writes `episodes.parquet` (a row an episode), `table.csv`, `table.md`, a PNG a figure, `report.html` (interactive; needs
    the extra `laploop[report]`), `sweep.toml` and `summary.json`. Finished episodes are kept in `DIR/rows`: the same command
    resumes where it was stopped. The exit status is 1 if an episode could not be run.
    """

    sweep: tyro.conf.Positional[str]
    """Name of a shipped study (latency, delay-margin, error-budget, pattern), or the path of a sweep as TOML."""
    engine: Inlined[Engine] = field(default_factory=Engine)
    quick: bool = False
    """Run the sweep's short form."""
    seeds: int | None = None
    """Episodes a condition, in place of the sweep's number."""
    trust: bool = False
    """Accept module:Class from the sweep's file, which runs the code it names."""
    out: OutputPath


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen = parse(StudyArguments, arguments, "study")

    from laploop.studies.sweeps.results import write_results  # slow to import
    from laploop.studies.sweeps.run import run_sweep
    from laploop.studies.sweeps.sweep_file import read_sweep

    sweep = read_sweep(chosen.sweep, quick=chosen.quick, seeds=chosen.seeds, trust=chosen.trust)
    with OutputFolder(chosen.out, "study") as folder:
        with progress_bar("episodes", sweep.count) as advance_to:
            outcomes = run_sweep(sweep, folder.path, chosen.engine, advance_to)
        command = shlex.join(["laploop", "study", *arguments])
        results = write_results(sweep, outcomes, folder.artefact, command=command)
        folder.write_summary(results, config={**asdict(chosen), "sweep_file": sweep.text}, seed=sweep.conditions[0].first_seed)
    if not results["report"]:
        warnings.warn(
            "no report.html without Plotly; install the extra: pip install 'laploop[report]'", LaploopNote, stacklevel=2
        )
    table = ResultTable(f"{sweep.title}, {sweep.seeds} seeds")
    first = sweep.metrics[0]
    for line in results["conditions"]:
        value = line["metrics"][first]["value"]
        table.row(line["condition"], None if value is None else value["mean"], first)
    table.show(folder.path)
    for failed in results["failed"]:
        sys.stderr.write(f"laploop study: {failed['condition']}, seed {failed['seed']}: {failed['error']}\n")
    return 1 if results["failed"] else 0
