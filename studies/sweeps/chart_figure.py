"""Charts as PNGs."""

import itertools
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from laploop.studies.figure_style import BLUE, GREY, ORANGE, RED, draw_grid, figure_page
from laploop.studies.sweeps.chart import Chart, Series

COLORS = (BLUE, ORANGE, "#009E73", RED, "#CC79A7", "#56B4E9", "#F0E442", GREY)
"""Of the series, in their order; a theory has the color of the measured series before it."""


def draw_chart(chart: Chart, path: Path | str) -> None:
    """Draw a chart as a PNG, with intervals where it has them."""
    with figure_page(path, title=chart.title, width_in=8.0, height_in=5.0) as figure:
        axis = figure.subplots()
        if chart.kind == "bars":
            _bars(axis, chart)
        else:
            for series, color in colored(chart):
                _line(axis, series, color)
        axis.set(xlabel=chart.x_label, ylabel=chart.y_label)
        draw_grid(axis)
        if len(chart.series) > 1:
            axis.legend(frameon=False, fontsize=8, ncols=1 + len(chart.series) // 8)


def colored(chart: Chart) -> list[tuple[Series, str]]:
    """Return each series with its color."""
    colors = itertools.cycle(COLORS)
    found: list[tuple[Series, str]] = []
    for series in chart.series:
        follows = series.kind == "theory" and found and found[-1][0].kind == "measured"
        found.append((series, found[-1][1] if follows else next(colors)))
    return found


def _line(axis: Axes, series: Series, color: str) -> None:
    if series.kind == "theory":
        axis.plot(series.x, series.y, color=color, linewidth=1.1, linestyle="--", label=series.name)
        return
    axis.plot(series.x, series.y, color=color, marker="o", markersize=4, linewidth=1.4, label=series.name)
    if series.low is not None and series.high is not None:
        axis.fill_between(series.x, series.low, series.high, color=color, alpha=0.15, linewidth=0.0)


def _bars(axis: Axes, chart: Chart) -> None:
    categories = list(dict.fromkeys(str(x) for series in chart.series for x in series.x))
    width = 0.8 / len(chart.series)
    for number, (series, color) in enumerate(colored(chart)):
        shift = (number - 0.5 * (len(chart.series) - 1)) * width
        places = np.array([categories.index(str(x)) for x in series.x]) + shift
        axis.bar(places, series.y, width=0.9 * width, bottom=series.base, color=color, label=series.name)
        if series.low is not None and series.high is not None:
            top = np.array(series.y) + (0.0 if series.base is None else np.array(series.base))
            # The interval is the value's own; a bar on a base carries it at its end.
            reach = np.abs(np.array([np.array(series.y) - series.low, np.array(series.high) - series.y]))
            axis.errorbar(places, top, yerr=reach, fmt="none", ecolor="#333333", elinewidth=1.0, capsize=2)
    # Otherwise the ends of bars on a base stick to the axis and hide.
    axis.use_sticky_edges = False
    axis.margins(y=0.08)
    if axis.get_ylim()[0] < 0.0 and all(value >= 0.0 for series in chart.series for value in series.base or series.y):
        axis.set_ylim(bottom=0.0)
    axis.set_xticks(range(len(categories)), categories, rotation=20 if len(categories) > 4 else 0, ha="center")
