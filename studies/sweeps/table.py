"""The table of a sweep: a line a condition, with paired differences from the first condition of its part."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from laploop.studies.csv_text import csv_text
from laploop.studies.episodes.trials import wilson_interval
from laploop.studies.sweeps.analyses.findings import Findings
from laploop.studies.sweeps.bootstrap import difference, estimate
from laploop.studies.sweeps.run import Outcome
from laploop.studies.sweeps.sweep import Sweep


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


def table_markdown(sweep: Sweep, lines: Sequence[Mapping[str, Any]], found: Findings) -> str:
    """Return what was found in words, the table, and the analysis's own tables, as Markdown."""
    head, *body = table_cells(lines)
    pairing = "with the same seeds" if sweep.pairing == "same-seeds" else "each with seeds of its own"
    about = (
        f"{sweep.seeds} episodes a condition, {pairing}. Means with 95 % intervals; behind a semicolon, the difference from the"
    )
    rows = [f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |" for row in (head, *body)]
    said = [*(f"- {sentence}" for sentence in found.sentences), ""] if found.sentences else []
    above = [f"# {sweep.title}", "", *said, f"{about} first condition of the same part.", ""]
    return "\n".join([*above, rows[0], "|" + "---|" * len(head), *rows[1:], "", found.markdown]).rstrip() + "\n"


def _interval(found: Mapping[str, float] | None, sign: str = "") -> str:
    if found is None:
        return ""
    return f"{found['mean']:{sign}.3g} [{found['low']:{sign}.3g}, {found['high']:{sign}.3g}]"
