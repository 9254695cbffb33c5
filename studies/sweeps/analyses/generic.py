"""What any sweep shows: each metric of each part over its first axis of numbers, and the first of them in words."""

from collections.abc import Mapping, Sequence

from laploop.studies.sweeps.analyses.findings import Findings
from laploop.studies.sweeps.analyses.wording import quantity, spread
from laploop.studies.sweeps.bootstrap import difference, estimate
from laploop.studies.sweeps.chart import Chart, Series
from laploop.studies.sweeps.run import Outcome
from laploop.studies.sweeps.sweep import Label, Sweep, shown
from laploop.studies.sweeps.tick_metrics import METRICS

_SHOWN_METRICS = 4
"""Of a part in charts; tables have all."""


def analyse(sweep: Sweep, outcomes: Sequence[Outcome]) -> Findings:
    """Draw each metric of each part over its first axis of numbers, a series for each set of the other values."""
    charts: list[Chart | None] = []
    sentences: list[str] = []
    for part in parts_of(sweep, outcomes):
        metrics = sweep.metrics_of(part[0].condition.group)
        charts += [metric_chart(sweep, part, metric) for metric in metrics[:_SHOWN_METRICS]]
        sentences += changes(sweep, part, metrics[0])
    return Findings(charts=tuple(chart for chart in charts if chart is not None), sentences=tuple(sentences))


def parts_of(sweep: Sweep, outcomes: Sequence[Outcome]) -> list[list[Outcome]]:
    """Return the outcomes of each part, in the file's order."""
    return [[one for one in outcomes if one.condition.group == group] for group in sweep.groups()]


def metric_chart(sweep: Sweep, part: Sequence[Outcome], metric: str) -> Chart | None:
    """Return a chart of a metric over a part's numbers, or bars over its conditions where nothing numeric varies."""
    axis = numeric_axis(part)
    group = part[0].condition.group
    name = "-".join(filter(None, (group.replace(" ", "-"), metric)))
    title = ": ".join(filter(None, (group, METRICS[metric])))
    if axis is None:
        series = Series.of(METRICS[metric], [(_short(one.condition.values), estimate(one.values(metric))) for one in part])
        kept = (series,) if series.y else ()
        chart = Chart(name=name, title=title, x_label="", y_label=METRICS[metric], series=kept, kind="bars")
    else:
        lines = tuple(line for line in lines_over(part, axis, metric) if line.y)
        chart = Chart(name=name, title=title, x_label=sweep.label(axis), y_label=METRICS[metric], series=lines)
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
    lines = []
    for others, line in _lines(part, axis).items():
        points = [(float(one.condition.values[axis]), estimate(one.values(metric))) for one in line]
        lines.append(Series.of(others or METRICS[metric], points))
    return lines


def changes(sweep: Sweep, part: Sequence[Outcome], metric: str) -> list[str]:
    """Say how a metric changes, a sentence a line: between the ends of an axis of numbers, or from its first name to others."""
    axis = numeric_axis(part)
    compared = axis or next(iter(part[0].condition.values), None)
    if compared is None:
        return []
    what, unit = quantity(METRICS[metric])
    name, axis_unit = quantity(sweep.label(compared))
    sentences = []
    for others, (first, *rest) in _lines(part, compared).items():
        about = ", ".join(filter(None, (part[0].condition.group, others)))
        for last in rest if axis is None else rest[-1:]:
            before, after = estimate(first.values(metric)), estimate(last.values(metric))
            apart = difference(last.values(metric), first.values(metric), paired=sweep.pairing == "same-seeds")
            if before is None or after is None or apart is None:
                continue
            start, end = (shown(one.condition.values[compared]) for one in (first, last))
            way = f"{name} from {start} to {end}{axis_unit}" if axis else f"{end} in place of {start}"
            sentences.append(
                f"{about}: with {way}, the {what} goes from {before.mean:.3g} to {after.mean:.3g}{unit}, "
                f"a difference of {spread(apart, sign='+')}."
            )
    return [sentence[0].upper() + sentence[1:] for sentence in sentences]


def _lines(part: Sequence[Outcome], axis: str) -> dict[str, list[Outcome]]:
    """Return the outcomes of each set of the other values, by name, sorted along an axis of numbers."""
    lines: dict[str, list[Outcome]] = {}
    for one in part:
        others = _short({name: value for name, value in one.condition.values.items() if name != axis})
        lines.setdefault(others, []).append(one)
    if axis != numeric_axis(part):
        return lines
    return {name: sorted(line, key=lambda one: float(one.condition.values[axis])) for name, line in lines.items()}


def _short(values: Mapping[str, Label]) -> str:
    return ", ".join(
        str(value) if isinstance(value, str) and value not in {"real", "ideal"} else f"{axis.rpartition('.')[2]} {shown(value)}"
        for axis, value in values.items()
    )
