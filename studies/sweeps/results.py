"""Everything that a sweep leaves behind, written through the folder of the command that ran it."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from laploop.configuration import to_plain
from laploop.studies.sweeps.analyses.findings import analyse
from laploop.studies.sweeps.chart_figure import draw_chart
from laploop.studies.sweeps.report import can_report, write_report
from laploop.studies.sweeps.run import Outcome, write_parquet
from laploop.studies.sweeps.sweep import Sweep
from laploop.studies.sweeps.table import lines_of, table_cells, table_csv, table_markdown
from laploop.studies.timing.machine import describe_machine

Artefact = Callable[[str], AbstractContextManager[Path]]


def write_results(sweep: Sweep, outcomes: Sequence[Outcome], artefact: Artefact, *, command: str) -> dict[str, Any]:
    """Write tables, figures and, with Plotly, the report; return what `summary.json` holds.

    Args:
        sweep: What was run.
        outcomes: Its rows.
        artefact: Gives the path to write an artefact of that name to.
        command: What repeats the study.
    """
    lines, found, machine = lines_of(sweep, outcomes), analyse(sweep, outcomes), describe_machine()
    with artefact("episodes.parquet") as path:
        write_parquet(outcomes, path)
    texts = {"table.csv": table_csv(lines), "table.md": table_markdown(sweep, lines, found), "sweep.toml": sweep.text}
    for name, text in texts.items():
        with artefact(name) as path:
            path.write_text(text, encoding="utf-8")
    for chart in found.charts:
        with artefact(f"{chart.name}.png") as path:
            draw_chart(chart, path)
    if can_report():
        with artefact("report.html") as path:
            write_report(
                path,
                title=sweep.title,
                about=sweep.about,
                sentences=found.sentences,
                charts=found.charts,
                table=table_cells(lines),
                command=command,
                sweep_text=sweep.text,
                machine=machine,
            )
    return {
        "study": sweep.name,
        "quick": sweep.quick,
        "seeds": sweep.seeds,
        "conditions": lines,
        "analysis": found.results,
        "sentences": list(found.sentences),
        "tables": found.markdown,
        "charts": [asdict(chart) for chart in found.charts],
        "failed": _failed(outcomes),
        "report": can_report(),
        "repeat": command,
        "machine": machine,
    }


def _failed(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    return [
        {
            "condition": one.condition.name,
            "seed": row["seed"],
            "error": row["error"],
            "episode": to_plain(one.condition.episode),
        }
        for one in outcomes
        for row in one.rows
        if row["error"] is not None
    ]
