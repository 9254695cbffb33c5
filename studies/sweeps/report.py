"""The results of a sweep as one interactive page, which needs nothing but a browser; needs the extra `laploop[report]`."""

import html
import json
import re
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from laploop.studies.sweeps.chart import Chart, Series
from laploop.studies.sweeps.chart_figure import colored

_STYLE = "body{font:15px sans-serif;max-width:60em;margin:2em auto;padding:0 1em}table{border-collapse:collapse;font-size:13px}"
_STYLE += "td,th{border:1px solid #ccc;padding:2px 6px}pre{background:#f4f4f4;padding:1em;overflow-x:auto}"


def can_report() -> bool:
    """Return whether Plotly is installed."""
    return find_spec("plotly") is not None


def write_report(
    path: Path,
    *,
    title: str,
    about: str,
    sentences: Sequence[str],
    charts: Sequence[Chart],
    table: Sequence[Sequence[str]],
    command: str,
    sweep_text: str,
    machine: Mapping[str, Any],
) -> None:
    """Write the page; the first row of the table is its header. Plotly's code is part of the page: it asks no other machine."""
    parts = [f"<h1>{html.escape(title)}</h1>", f"<p>{html.escape(about)}</p>"]
    if sentences:
        parts += ["<ul>", *(f"<li>{_words(sentence)}</li>" for sentence in sentences), "</ul>"]
    for number, chart in enumerate(charts):
        parts += [_chart(chart, first=number == 0), f"<p>{html.escape(chart.note)}</p>"]
    head, *body = table
    parts += ["<h2>Table</h2>", "<table>", _row(head, "th"), *(_row(row, "td") for row in body), "</table>"]
    parts += ["<h2>To repeat it</h2>", f"<pre>{html.escape(command)}</pre>"]
    parts += ["<h2>Configuration</h2>", f"<pre>{html.escape(sweep_text)}</pre>"]
    parts += ["<h2>Machine</h2>", f"<pre>{html.escape(json.dumps(machine, indent=2))}</pre>"]
    head_tag = f'<head><meta charset="utf-8"><title>{html.escape(title)}</title><style>{_STYLE}</style></head>'
    page = f"<!DOCTYPE html>\n<html>{head_tag}<body>\n" + "\n".join(parts) + "\n</body></html>\n"
    path.write_text(page, encoding="utf-8")


def _chart(chart: Chart, *, first: bool) -> str:
    from plotly import graph_objects  # an extra

    figure = graph_objects.Figure()
    for series, color in colored(chart):
        figure.add_trace(_trace(graph_objects, chart, series, color))
    figure.update_layout(
        title=chart.title, xaxis_title=chart.x_label, yaxis_title=chart.y_label, template="plotly_white", barmode="group"
    )
    return str(figure.to_html(full_html=False, include_plotlyjs=first))


def _trace(graph_objects: Any, chart: Chart, series: Series, color: str) -> Any:
    errors: dict[str, Any] | None = None
    if series.low is not None and series.high is not None:
        above = [high - y for high, y in zip(series.high, series.y, strict=True)]
        below = [y - low for low, y in zip(series.low, series.y, strict=True)]
        errors = {"type": "data", "symmetric": False, "array": above, "arrayminus": below}
    shared = {"name": series.name, "x": list(series.x), "y": list(series.y), "error_y": errors}
    if chart.kind == "bars":
        base = None if series.base is None else list(series.base)
        return graph_objects.Bar(**shared, base=base, marker_color=color)
    if series.kind == "theory":
        return graph_objects.Scatter(**shared, mode="lines", line={"color": color, "dash": "dash"})
    return graph_objects.Scatter(**shared, mode="lines+markers", line={"color": color})


def _words(sentence: str) -> str:
    """Return a sentence as HTML, with code where it has backticks."""
    return re.sub("`([^`]*)`", r"<code>\1</code>", html.escape(sentence))


def _row(cells: Sequence[str], tag: str) -> str:
    return "<tr>" + "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in cells) + "</tr>"
