"""A picture of what the sensor lets one know, from the committed summaries: contrast, and error against the photon floor.

`python -P -m laploop.studies.readme.sensor_figure docs/results docs/pictures/sensor.png` draws it.
"""

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from laploop.arrays import Array
from laploop.assets.scope_optics import ScopeOptics
from laploop.perception.geometry import Rig
from laploop.studies.figure_style import BLUE, GREY, ORANGE, RED, draw_grid, figure_page
from laploop.studies.readme.summaries import read_summary
from laploop.whole_file import whole_file

_MODELS = {
    "compact": (BLUE, "o-"),
    "ssle-phase": (ORANGE, "s-"),
    "photon floor, 1 row": (GREY, "--"),
    "photon floor, 5 rows": (GREY, ":"),
}


def depth_per_turn(depth_m: Array, rig: Rig) -> Array:
    """Return by how much depth changes, in metres, per turn of the stripes' phase: Z^2 tau / b.

    Args:
        depth_m: Distances along the optical axis.
        rig: Its projector's period tau, as a tangent, and baseline b.
    """
    return np.asarray(np.square(depth_m) * rig.mask.period_tan / rig.baseline_m)


def draw_sensor(results: Path, path: Path) -> None:
    """Draw contrast, sensitivity and depth error against distance.

    Raises:
        MissingFileError: If the folder of results lacks a summary.
        OutputError: If the picture cannot be written.
    """
    contrast, depth = (read_summary(results / f"{name}.json") for name in ("characterization", "robustness"))
    with (
        whole_file(path) as partial,
        figure_page(partial, title="What the sensor lets one know", width_in=11.0, height_in=3.4) as figure,
    ):
        left, middle, right = figure.subplots(1, 3)
        by_distance = contrast["contrast_by_distance"]
        left.plot([float(one) for one in by_distance], list(by_distance.values()), "o-", color=BLUE, label="simulated")
        left.plot([70.0, 100.0], [0.58, 0.44], "x", color=RED, markersize=9, label="measured on a real scope")
        left.set(title="contrast of the stripes", ylabel="Michelson contrast", ylim=(0.0, 0.7))
        distance_mm = np.linspace(50.0, 150.0, 101)
        rig = Rig.from_optics(ScopeOptics())
        middle.plot(distance_mm, 1e3 * depth_per_turn(1e-3 * distance_mm, rig) / 100.0, color=BLUE)
        middle.set(title="what an error of 1/100 stripe costs", ylabel="depth error, mm", ylim=(0.0, None))
        _draw_errors(right, depth)
        for axis in (left, middle, right):
            axis.set_xlabel("distance, mm")
            draw_grid(axis)
        left.legend(frameon=False)
        right.legend(frameon=False)


def _draw_errors(axis: Axes, summary: Mapping[str, Any]) -> None:
    for model, (colour, style) in _MODELS.items():
        rows = [row for row in summary["rows"] if row["model"] == model and row["against"] == "exact"]
        bins = [
            (row["working_distance_mm"].split("-"), row["valid_mae_mm"]) for row in rows if "-" in row["working_distance_mm"]
        ]
        middles = [0.5 * (float(low) + float(high)) for (low, high), _ in bins]
        axis.plot(middles, [error for _, error in bins], style, color=colour, label=model, markersize=4)
    axis.set(title="depth error where valid", ylabel="mean absolute error, mm", ylim=(0.0, None))


def main(arguments: Sequence[str]) -> None:
    """Draw the picture: `arguments` are the folder of results and the file."""
    results, path = (Path(argument) for argument in arguments)
    draw_sensor(results, path)


if __name__ == "__main__":
    main(sys.argv[1:])
