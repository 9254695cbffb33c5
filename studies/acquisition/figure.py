"""Figures of a collected data set: example pairs, and histograms."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from laploop.perception.data.pair_store import PairStore
from laploop.studies.acquisition.card import PairStatistics
from laploop.studies.figure_style import BLUE, draw_grid, figure_page

_ROWS = 4
_DIFFERENCE_MM = 1.0


def draw_examples(store: PairStore, statistics: PairStatistics, path: Path | str) -> None:
    """Draw pairs at distances spread over the range: image, colour picture, reference and exact depth, and their difference."""
    by_distance = np.argsort(statistics.working_distance_mm)
    rows = min(_ROWS, len(store))
    chosen = by_distance[np.linspace(0, len(store) - 1, rows).round().astype(int)]
    titles = ("scope, under stripes", "reference camera", "reference depth [mm]", "exact depth [mm]", "reference - exact [mm]")
    with figure_page(path, title="Pairs of the data set", width_in=13.0, height_in=0.9 + 2.55 * rows) as figure:
        axes = figure.subplots(rows, len(titles), squeeze=False)
        for row, index in enumerate(chosen):
            frame = store.frame(int(index))
            low, high = np.nanpercentile(frame.depth_mm, [1.0, 99.0])
            depth: dict[str, Any] = {"cmap": "viridis", "vmin": low, "vmax": high}
            difference = frame.reference_depth_mm - frame.depth_mm
            axes[row, 0].imshow(frame.image, cmap="gray", vmin=0, vmax=max(float(np.percentile(frame.image, 99.8)), 1.0))
            axes[row, 1].imshow(frame.reference_rgba)
            for column, values in ((2, frame.reference_depth_mm), (3, frame.depth_mm)):
                figure.colorbar(axes[row, column].imshow(values, **depth), ax=axes[row, column], shrink=0.8)
            picture = axes[row, 4].imshow(difference, cmap="coolwarm", vmin=-_DIFFERENCE_MM, vmax=_DIFFERENCE_MM)
            figure.colorbar(picture, ax=axes[row, 4], shrink=0.8)
            axes[row, 0].set_ylabel(f"pair {index}, {statistics.working_distance_mm[index]:.0f} mm")
            for axis in axes[row]:
                axis.set(xticks=[], yticks=[], facecolor="#cccccc")
        for axis, title in zip(axes[0], titles, strict=True):
            axis.set_title(title)


def draw_statistics(statistics: PairStatistics, path: Path | str) -> None:
    """Draw histograms over the pairs."""
    with figure_page(path, title="Statistics of the pairs", width_in=10.0, height_in=5.6) as figure:
        axes = figure.subplots(2, 3)
        _draw_histogram(axes[0, 0], statistics.working_distance_mm, "commanded working distance [mm]")
        _draw_histogram(axes[0, 1], 100.0 * statistics.valid_share, "image with a reference depth [%]")
        _draw_histogram(axes[0, 2], 100.0 * statistics.lit_share, "image that the projector reaches [%]")
        _draw_histogram(axes[1, 0], statistics.difference_median_mm, "median of reference - exact depth [mm]")
        _draw_histogram(axes[1, 1], statistics.difference_p95_mm, "95th percentile of its magnitude [mm]")
        axes[1, 2].plot(statistics.working_distance_mm, statistics.grey_mean, ".", color=BLUE, markersize=4)
        axes[1, 2].set(xlabel="commanded working distance [mm]", ylabel="mean grey value")
        axes[1, 2].set_ylim(bottom=0.0)
        draw_grid(axes[1, 2])


def _draw_histogram(axis: Axes, values: np.ndarray[Any, Any], label: str) -> None:
    axis.hist(values, bins=20, color=BLUE)
    axis.set(xlabel=label, ylabel="pairs")
    draw_grid(axis)
