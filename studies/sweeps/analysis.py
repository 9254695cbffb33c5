"""What every sweep reports: a row per condition, paired differences from the first condition of its part, and charts."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib import import_module
from typing import Any

from laploop.errors import UnknownNameError
from laploop.studies.csv_text import csv_text
from laploop.studies.episodes.trials import wilson_interval
from laploop.studies.sweeps.bootstrap import Estimate, difference, estimate
from laploop.studies.sweeps.chart import Chart, Series
from laploop.studies.sweeps.run import Outcome
from laploop.studies.sweeps.sweep import Label, Sweep, shown
from laploop.studies.sweeps.tick_metrics import METRICS

_SHOWN_METRICS = 4
"""Of a part in charts; tables have all."""


@dataclass(frozen=True, kw_only=True)
class Findings:
    """What an analysis makes of the rows."""

    charts: tuple[Chart, ...]
    results: Mapping[str, Any] = field(default_factory=dict)
    """For `summary.json`."""
    markdown: str = ""
    """Tables of its own."""


Analysis = Callable[[Sweep, Sequence[Outcome]], Findings]

ANALYSES = ("generic", "latency", "delay-margin", "error-budget", "pattern")
"""By the name that a sweep's file gives; `generic` alone does for any sweep."""


def analyse(sweep: Sweep, outcomes: Sequence[Outcome]) -> Findings:
    """Return what the sweep's own analysis finds.

    Raises:
        UnknownNameError: If there is no analysis of that name.
    """
    return analysis_named(sweep.analysis)(sweep, outcomes)


def analysis_named(name: str) -> Analysis:
    """Return an analysis.

    Raises:
        UnknownNameError: If there is none of that name.
    """
    if name == "generic":
        return analyse_generally
    if name not in ANALYSES:
        raise UnknownNameError("analysis", name, ANALYSES)
    found: Analysis = import_module(f"laploop.studies.sweeps.{name.replace('-', '_')}").analyse
    return found


def analyse_generally(sweep: Sweep, outcomes: Sequence[Outcome]) -> Findings:
    """Draw each metric of each part over its first axis of numbers, a series for each set of the other values."""
    parts = [[one for one in outcomes if one.condition.group == group] for group in sweep.groups()]
    charts = (
        metric_chart(part, metric) for part in parts for metric in sweep.metrics_of(part[0].condition.group)[:_SHOWN_METRICS]
    )
    return Findings(charts=tuple(chart for chart in charts if chart is not None))


def metric_chart(part: Sequence[Outcome], metric: str, *, title: str = "") -> Chart | None:
    """Return a chart of a metric over a part's numbers, or bars over its conditions where nothing numeric varies."""
    axis = numeric_axis(part)
    group = part[0].condition.group
    name = "-".join(filter(None, (group.replace(" ", "-"), metric)))
    title = title or ": ".join(filter(None, (group, METRICS[metric])))
    if axis is None:
        series = Series.of(METRICS[metric], [(_short(one.condition.values), estimate(one.values(metric))) for one in part])
        kept = (series,) if series.y else ()
        chart = Chart(name=name, title=title, x_label="", y_label=METRICS[metric], series=kept, kind="bars")
    else:
        lines = tuple(line for line in lines_over(part, axis, metric) if line.y)
        chart = Chart(name=name, title=title, x_label=axis, y_label=METRICS[metric], series=lines)
    return chart if chart.series else None


def numeric_axis(part: Sequence[Outcome]) -> str | None:
    """Return the first axis of at least two different numbers."""
    for axis in part[0].condition.values:
        values = {one.condition.values[axis] for one in part}
        if len(values) > 1 and all(isinstance(value, int | float) and not isinstance(value, bool) for value in values):
            return axis
    return None


def lines_over(part: Sequence[Outcome], axis: str, metric: str) -> list[Series]:
    """Return a series of a metric over an axis for each set of the other values."""
    lines: dict[str, list[tuple[Any, Estimate | None]]] = {}
    for one in part:
        others = _short({name: value for name, value in one.condition.values.items() if name != axis})
        point = float(one.condition.values[axis]), estimate(one.values(metric))
        lines.setdefault(others or METRICS[metric], []).append(point)
    return [Series.of(name, sorted(points, key=lambda point: point[0])) for name, points in lines.items()]


def _short(values: Mapping[str, Label]) -> str:
    return ", ".join(
        str(value) if isinstance(value, str) and value not in {"real", "ideal"} else f"{axis.rpartition('.')[2]} {shown(value)}"
        for axis, value in values.items()
    )


def lines_of(sweep: Sweep, outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """Return a line a condition: its values, episodes, success, and each metric's mean and difference, with 95 % intervals.

    Differences are from the first condition of the same part.
    """
    first: dict[str, Outcome] = {}
    lines = []
    for one in outcomes:
        base = first.setdefault(one.condition.group, one)
        successes = sum(bool(row["success"]) for row in one.rows)
        metrics: dict[str, Any] = {}
        for metric in sweep.metrics:
            if metric not in sweep.metrics_of(one.condition.group):
                metrics[metric] = {"value": None, "difference": None}
                continue
            found = estimate(one.values(metric))
            paired = sweep.pairing == "same-seeds"
            apart = None if base is one else difference(one.values(metric), base.values(metric), paired=paired)
            metrics[metric] = {
                "value": None if found is None else asdict(found),
                "difference": None if apart is None else asdict(apart),
            }
        lines.append(
            {
                "condition": one.condition.name,
                "group": one.condition.group,
                "values": dict(one.condition.values),
                "episodes": len(one.rows),
                "errors": sum(row["error"] is not None for row in one.rows),
                "success_rate": successes / len(one.rows),
                "success_interval_95": wilson_interval(successes, len(one.rows)),
                "metrics": metrics,
            }
        )
    return lines


def table_csv(lines: Sequence[Mapping[str, Any]]) -> str:
    """Return the lines as CSV, a line a condition."""
    axes = tuple(dict.fromkeys(axis for line in lines for axis in line["values"]))
    metrics = tuple(lines[0]["metrics"])
    parts = [(metric, kind, part) for metric in metrics for kind in ("value", "difference") for part in ("mean", "low", "high")]
    names = (f"{metric}_{part}" if kind == "value" else f"{metric}_difference_{part}" for metric, kind, part in parts)
    columns = ("condition", "group", *axes, "episodes", "errors", "success_rate", *names)
    return csv_text(
        columns,
        (
            [
                line["condition"],
                line["group"],
                *(line["values"].get(axis) for axis in axes),
                line["episodes"],
                line["errors"],
                line["success_rate"],
                *((line["metrics"][metric][kind] or {}).get(part) for metric, kind, part in parts),
            ]
            for line in lines
        ),
    )


def table_cells(lines: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """Return the table for readers, its header first: means with their intervals, differences where there is a base."""
    metrics = tuple(lines[0]["metrics"])
    cells = [["condition", "episodes", "success", *metrics]]
    for line in lines:
        values = []
        for metric in metrics:
            found = line["metrics"][metric]
            text = _interval(found["value"])
            values.append(text if found["difference"] is None else f"{text}; {_interval(found['difference'], sign='+')}")
        cells.append([line["condition"], str(line["episodes"]), f"{100 * line['success_rate']:.0f} %", *values])
    return cells


def table_markdown(sweep: Sweep, lines: Sequence[Mapping[str, Any]], more: str = "") -> str:
    """Return the table as Markdown."""
    head, *body = table_cells(lines)
    pairing = "with the same seeds" if sweep.pairing == "same-seeds" else "each with seeds of its own"
    about = (
        f"{sweep.seeds} episodes a condition, {pairing}. Means with 95 % intervals; behind a semicolon, the difference from the"
    )
    rows = [f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |" for row in (head, *body)]
    lines_of_text = [f"# {sweep.title}", "", f"{about} first condition of the same part.", ""]
    return "\n".join([*lines_of_text, rows[0], "|" + "---|" * len(head), *rows[1:], "", more]).rstrip() + "\n"


def _interval(found: Mapping[str, float] | None, sign: str = "") -> str:
    if found is None:
        return ""
    return f"{found['mean']:{sign}.3g} [{found['low']:{sign}.3g}, {found['high']:{sign}.3g}]"
