"""The results on the pages of the studies, from the committed summaries of full runs.

`python -P -m laploop.studies.readme.study_pages docs/results docs/studies` rewrites the block of results of every page, and
draws the charts that the page shows, `../pictures/study-CHART.png`; a test checks that text and charts are there.
"""

import json
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from laploop.errors import UnknownNameError
from laploop.studies.readme.results_page import with_results
from laploop.studies.sweeps.chart import Chart
from laploop.studies.sweeps.chart_figure import draw_chart
from laploop.studies.sweeps.sweep_file import shipped_names
from laploop.whole_file import whole_file

NOTHING = "No full run is committed yet."

PICTURE = "../pictures/study-{chart}.png"
"""Of a chart, from a page."""


def study_block(summary: Mapping[str, Any] | None) -> str:
    """Return what a page says of a study's results: what was run, and the tables of its analysis."""
    if summary is None:
        return NOTHING
    machine, failed = summary["machine"], len(summary["failed"])
    episodes = sum(line["episodes"] for line in summary["conditions"])
    lines = [
        f"{episodes} episodes, {summary['seeds']} a condition, laploop {summary['versions']['laploop']}, {machine['cpu']}.",
        f"`{summary['repeat']}`",
    ]
    if failed:
        lines.append(f"{failed} episodes could not be run.")
    lines.append("\n".join(f"- {sentence}" for sentence in summary["sentences"]))
    # They stand below a heading of the page.
    tables = "\n".join(f"#{line}" if line.startswith("## ") else line for line in summary["tables"].splitlines())
    return "\n\n".join([*lines, tables])


def charts_of(page: str, summary: Mapping[str, Any] | None) -> list[Chart]:
    """Return the charts of a study that its page shows.

    Raises:
        UnknownNameError: If the page shows one that the study does not have.
    """
    if summary is None:
        return []
    charts = {plain["name"]: Chart.from_plain(plain) for plain in summary["charts"]}
    shown = re.findall(re.escape(PICTURE).replace(re.escape("{chart}"), r"([\w-]+)"), page)
    for name in shown:
        if name not in charts:
            raise UnknownNameError(f"chart of the study {summary['study']}", name, charts)
    return [charts[name] for name in shown]


def main(arguments: Sequence[str]) -> None:
    """Rewrite the pages: `arguments` are the folder of results and that of the pages."""
    results, pages = (Path(argument) for argument in arguments)
    for name in shipped_names():
        source, page = results / f"study-{name}.json", pages / f"{name}.md"
        summary = json.loads(source.read_text(encoding="utf-8")) if source.is_file() else None
        text = with_results(page.read_text(encoding="utf-8"), study_block(summary))
        for chart in charts_of(text, summary):
            draw_chart(chart, page.parent / PICTURE.format(chart=chart.name))
        with whole_file(page) as partial:
            partial.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
