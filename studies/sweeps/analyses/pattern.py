"""Tells how the pattern and its light decide the error of depth, and how far a single pattern is unambiguous."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from laploop.assets.scope_optics import ScopeOptics
from laploop.perception.working_range import WORKING_RANGE_MM
from laploop.studies.sweeps.analyses import generic
from laploop.studies.sweeps.analyses.findings import Findings
from laploop.studies.sweeps.bootstrap import estimate
from laploop.studies.sweeps.chart import Chart, Series
from laploop.studies.sweeps.run import Outcome
from laploop.studies.sweeps.sweep import Sweep

_KEPT_OF_VALID = 0.9
"""Fraction of a part's largest valid fraction that the best has to keep: who gives up where it is hard looks accurate."""


def analyse(sweep: Sweep, outcomes: Sequence[Outcome]) -> Findings:
    """Return the charts of every part, and the farthest unambiguous depth where it changes."""
    charts: list[Chart | None] = []
    ranges: list[dict[str, Any]] = []
    near_mm, far_mm = WORKING_RANGE_MM
    rule = f"unambiguous from {near_mm:g} to {far_mm:g} mm and keeps nine tenths of the largest valid fraction of its part"
    sentences = [f"Best is the smallest mean error of depth among what is {rule}."]
    for part in generic.parts_of(sweep, outcomes):
        charts += [generic.metric_chart(sweep, part, metric) for metric in sweep.metrics_of(part[0].condition.group)]
        found = [_measured(one) for one in part]
        if len({line["farthest_mm"] for line in found}) > 1:
            ranges += found
            charts.append(_range_chart(sweep, part))
        sentences += _best(part[0].condition.group, found)
    kept = tuple(chart for chart in charts if chart is not None)
    results = {"unambiguous": ranges}
    return Findings(charts=kept, results=results, sentences=tuple(sentences), markdown=_markdown(ranges))


def farthest_unambiguous_mm(scope: ScopeOptics, nearest_mm: float = WORKING_RANGE_MM[0]) -> float:
    """Return the depth up to which the number of a stripe follows from its phase, if nothing is nearer than a depth.

    A point at depth z is lit by the stripe b / z, in tangents, beside where it is seen. So phases repeat once
    b / near - b / far is a period. Infinite where even the farthest point is less than a period away.
    """
    periods_per_m = scope.mask.period_tan / scope.baseline_m
    left = 1e3 / nearest_mm - periods_per_m
    return 1e3 / left if left > 0.0 else math.inf


def _measured(one: Outcome) -> dict[str, Any]:
    error, valid = (estimate(one.values(metric)) for metric in ("depth_mae_mm", "depth_valid_fraction"))
    return {
        "condition": one.condition.name,
        "nearest_mm": WORKING_RANGE_MM[0],
        "farthest_mm": farthest_unambiguous_mm(one.condition.episode.task.loop.theatre.scope),
        "depth_mae_mm": None if error is None else error.mean,
        "depth_valid_fraction": None if valid is None else valid.mean,
    }


def _best(group: str, found: Sequence[dict[str, Any]]) -> list[str]:
    """Name the best of a part, and what would have a smaller error if it were not ambiguous in the working range."""
    known = [line for line in found if line["depth_mae_mm"] is not None]
    most = max((line["depth_valid_fraction"] for line in known), default=0.0)
    usable = [
        line
        for line in known
        if line["farthest_mm"] >= WORKING_RANGE_MM[1] and line["depth_valid_fraction"] >= _KEPT_OF_VALID * most
    ]
    if not usable:
        return []
    best = min(usable, key=lambda line: line["depth_mae_mm"])
    return [f"Best {group}: {_told(best)}."] + [
        f"Ambiguous beyond {line['farthest_mm']:.0f} mm: {_told(line)}."
        for line in known
        if line["farthest_mm"] < WORKING_RANGE_MM[1] and line["depth_mae_mm"] < best["depth_mae_mm"]
    ]


def _told(line: Mapping[str, Any]) -> str:
    name = str(line["condition"]).rpartition(": ")[2]
    return f"`{name}`, error {line['depth_mae_mm']:.3g} mm, {100 * line['depth_valid_fraction']:.0f} % valid"


def _range_chart(sweep: Sweep, part: Sequence[Outcome]) -> Chart | None:
    if (axis := generic.numeric_axis(part)) is None:
        return None
    points = [
        (float(one.condition.values[axis]), far)
        for one in part
        if math.isfinite(far := farthest_unambiguous_mm(one.condition.episode.task.loop.theatre.scope))
    ]
    if not points:
        return None
    group = part[0].condition.group
    return Chart(
        name="-".join(filter(None, (group.replace(" ", "-"), "unambiguous"))),
        title=f"{group}: farthest unambiguous depth, from {WORKING_RANGE_MM[0]:g} mm on",
        x_label=sweep.label(axis),
        y_label="farthest unambiguous depth [mm]",
        series=(Series(name="by geometry", x=[x for x, _ in points], y=[y for _, y in points], kind="theory"),),
        note="By geometry alone; values without a limit are left out.",
    )


def _markdown(ranges: Sequence[dict[str, Any]]) -> str:
    lines = ["## Unambiguous range", "", "| condition | from [mm] | to [mm] | error of depth [mm] |", "|---|---|---|---|"]
    for one in ranges:
        far = "no limit" if math.isinf(one["farthest_mm"]) else f"{one['farthest_mm']:.0f}"
        error = "" if one["depth_mae_mm"] is None else f"{one['depth_mae_mm']:.3g}"
        lines.append(f"| {one['condition']} | {one['nearest_mm']:g} | {far} | {error} |")
    return "\n".join(lines)
