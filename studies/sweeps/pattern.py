"""Tells how the pattern and its light decide the error of depth, and how far a single pattern is unambiguous."""

import math
from collections.abc import Sequence
from typing import Any

from laploop.assets.scope_optics import ScopeOptics
from laploop.perception.working_range import WORKING_RANGE_MM
from laploop.studies.sweeps.analysis import Findings, metric_chart, numeric_axis
from laploop.studies.sweeps.bootstrap import estimate
from laploop.studies.sweeps.chart import Chart, Series
from laploop.studies.sweeps.run import Outcome
from laploop.studies.sweeps.sweep import Sweep


def analyse(sweep: Sweep, outcomes: Sequence[Outcome]) -> Findings:
    """Return the charts of every part, and the farthest unambiguous depth where it changes."""
    charts: list[Chart | None] = []
    ranges: list[dict[str, Any]] = []
    for group in sweep.groups():
        part = [one for one in outcomes if one.condition.group == group]
        charts += [metric_chart(part, metric) for metric in sweep.metrics_of(group)]
        found = [_farthest_of(one) for one in part]
        if len({line["farthest_mm"] for line in found}) > 1:
            ranges += found
            charts.append(_range_chart(part))
    kept = tuple(chart for chart in charts if chart is not None)
    return Findings(charts=kept, results={"unambiguous": ranges}, markdown=_markdown(ranges))


def farthest_unambiguous_mm(scope: ScopeOptics, nearest_mm: float = WORKING_RANGE_MM[0]) -> float:
    """Return the depth up to which the number of a stripe follows from its phase, if nothing is nearer than a depth.

    A point at depth z is lit by the stripe b / z, in tangents, beside where it is seen. So phases repeat once
    b / near - b / far is a period. Infinite where even the farthest point is less than a period away.
    """
    periods_per_m = scope.mask.period_tan / scope.baseline_m
    left = 1e3 / nearest_mm - periods_per_m
    return 1e3 / left if left > 0.0 else math.inf


def _farthest_of(one: Outcome) -> dict[str, Any]:
    error = estimate(one.values("depth_mae_mm"))
    return {
        "condition": one.condition.name,
        "nearest_mm": WORKING_RANGE_MM[0],
        "farthest_mm": farthest_unambiguous_mm(one.condition.episode.task.loop.theatre.scope),
        "depth_mae_mm": None if error is None else error.mean,
    }


def _range_chart(part: Sequence[Outcome]) -> Chart | None:
    if (axis := numeric_axis(part)) is None:
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
        x_label=axis,
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
