"""Curves of the learners: `python -P -m laploop.studies.learners.baselines_figure docs/results/baselines.json PNG`."""

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from laploop.errors import InvalidValueError
from laploop.studies.figure_style import draw_grid, figure_page
from laploop.studies.sweeps.chart_figure import COLORS

_SHOWN = {"success": "rate of success", "total_return": "return of an episode"}


def draw_curves(runs: Mapping[str, Any], path: Path) -> None:
    """Draw, for each task, success and return over the decisions so far: a color a method, a line a seed.

    Raises:
        InvalidValueError: If no run has a curve of an environment.
    """
    learners = [
        run for run in runs.values() if run["curve"] is not None and any(part is not None for part in run["curve"]["success"])
    ]
    if not learners:
        raise InvalidValueError("runs", list(runs), "at least one that learns in an environment")
    tasks = list(dict.fromkeys(run["environment"] for run in learners))
    with figure_page(path, title="Learning, by decisions of 40 ms", width_in=9.0, height_in=3.2 * len(tasks)) as figure:
        axes = figure.subplots(len(tasks), len(_SHOWN), squeeze=False)
        for row, task in zip(axes, tasks, strict=True):
            own = [run for run in learners if run["environment"] == task]
            methods = list(dict.fromkeys(run["method"] for run in own))
            for axis, (key, label) in zip(row, _SHOWN.items(), strict=True):
                for run in own:
                    curve, number = run["curve"], methods.index(run["method"])
                    first = next(other for other in own if other["method"] == run["method"]) is run
                    axis.plot(
                        np.array(curve["steps"], float) / 1e3,
                        np.array(curve[key], float),
                        color=COLORS[number % len(COLORS)],
                        linewidth=1.3,
                        label=run["method"] if first else None,
                    )
                axis.set(xlabel="thousand decisions", ylabel=label, title=task.rpartition("/")[2])
                draw_grid(axis)
            row[0].set_ylim(-0.03, 1.03)
            row[0].legend(frameon=False, fontsize=8)


def main(arguments: Sequence[str]) -> None:
    """Draw: `arguments` are the file of the table and the PNG."""
    source, path = (Path(argument) for argument in arguments)
    draw_curves(json.loads(source.read_text(encoding="utf-8"))["runs"], path)


if __name__ == "__main__":
    main(sys.argv[1:])
