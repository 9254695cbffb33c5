"""Figures of a depth evaluation, in the manner of the paper: comparison of the models, examples, error against distance."""

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from laploop.errors import InvalidValueError
from laploop.perception.metrics import DepthErrors, depth_metrics
from laploop.studies.depth.table import REFERENCE_ROW, DepthExample, DepthTable
from laploop.studies.figure_style import BLUE, GREY, ORANGE, RED, draw_grid, figure_page

ERROR_LIMIT_MM = 10.0
"""Upper end of the errors' colours."""

_DEPTH_COLOURS, _ERROR_COLOURS, _NOTHING = "viridis", "magma", "#d9d9d9"
_MODEL_COLOURS = (BLUE, RED, ORANGE, "#009E73", "#CC79A7", "#56B4E9", "#000000", "#F0E442")


def draw_comparison(table: DepthTable, path: Path | str, *, examples: int = 3) -> None:
    """Draw held-out examples as a PNG: stripe image, truth, each model's depth, and below it the error.

    Predictions are shown everywhere, errors where the truth counts. All models of an example share one scale of depth, and the
    whole page shares one of error.

    Raises:
        InvalidValueError: If the evaluation kept no example.
    """
    shown = _shown(table, examples)
    models = list(shown[0].estimates)
    columns = 2 + len(models)
    with figure_page(
        path, title="Held-out tissues: depth and its error", width_in=1.5 + 1.75 * columns, height_in=0.9 + 3.5 * len(shown)
    ) as figure:
        axes = figure.subplots(2 * len(shown), columns, squeeze=False)
        for row, example in enumerate(shown):
            limits, error_map = _depth_limits(example), None
            upper, lower = axes[2 * row], axes[2 * row + 1]
            _show(upper[0], example.image, cmap="gray", vmin=0, vmax=255)
            depth_map = _show_depth(upper[1], np.ma.masked_invalid(example.truth_mm), limits)
            for axis in lower[:2]:
                axis.axis("off")
            for place, (model, estimate) in enumerate(example.estimates.items(), start=2):
                _show_depth(upper[place], estimate.depth_mm, limits)
                error = np.abs(estimate.depth_mm - example.truth_mm)
                error_map = _show(
                    lower[place], _masked(error, example.mask), cmap=_ERROR_COLOURS, vmin=0.0, vmax=ERROR_LIMIT_MM
                )
                found = depth_metrics(estimate.depth_mm, example.truth_mm, example.mask)
                lower[place].set_xlabel(f"MAE {found.mae_mm:.2f} mm", fontsize=8)
                if row == 0:
                    upper[place].set_title(model)
            upper[0].set_ylabel(f"frame {example.index}", fontsize=8)
            _colour_bar(figure, depth_map, upper, "depth [mm]")
            _colour_bar(figure, error_map, lower, "absolute error [mm]", extend="max")
        axes[0, 0].set_title("stripe image")
        axes[0, 1].set_title(_truth_name(shown[0]))
        axes[1, 2].set_ylabel("absolute error", fontsize=8)


def draw_examples(table: DepthTable, model: str, path: Path | str) -> None:
    """Draw one model's examples as a PNG: image, prediction, masked prediction, truth, its mask; their metrics in the title.

    Raises:
        InvalidValueError: If the evaluation kept no example of the model.
    """
    shown = _shown(table, len(table.examples))
    if model not in shown[0].estimates:
        raise InvalidValueError("model", model, f"one of {', '.join(shown[0].estimates)}")
    errors = DepthErrors()
    for example in shown:
        errors.add(example.estimates[model].depth_mm, example.truth_mm, example.mask)
    found = errors.metrics()
    title = f"{model}: MAE {found.mae_mm:.2f} mm, AbsRel {found.abs_rel:.4f}, Acc(1.1) {found.acc_1_1:.3f} over these examples"
    names = ("stripe image", "prediction", "masked prediction", _truth_name(shown[0]), "validity mask")
    with figure_page(path, title=title, width_in=10.4, height_in=0.7 + 1.95 * len(shown)) as figure:
        axes = figure.subplots(len(shown), 5, squeeze=False)
        for row, example in enumerate(shown):
            limits = _depth_limits(example)
            depth_mm = example.estimates[model].depth_mm
            _show(axes[row, 0], example.image, cmap="gray", vmin=0, vmax=255)
            depth_map = _show_depth(axes[row, 1], depth_mm, limits)
            _show_depth(axes[row, 2], _masked(depth_mm, example.mask), limits)
            _show_depth(axes[row, 3], np.ma.masked_invalid(example.truth_mm), limits)
            _show(axes[row, 4], example.mask, cmap="gray", vmin=0, vmax=1)
            axes[row, 0].set_ylabel(f"frame {example.index}", fontsize=8)
            _colour_bar(figure, depth_map, axes[row], "depth [mm]")
        for axis, name in zip(axes[0], names, strict=True):
            axis.set_title(name)


def draw_distance(table: DepthTable, against: str, path: Path | str) -> None:
    """Draw mean absolute error against working distance as a PNG, with 95 % intervals over tissues and the photon floor.

    Left over all pixels that count, right over those that each model marks valid; logarithmic.

    Raises:
        InvalidValueError: If there is no row against `against`.
    """
    models = table.models(against)
    if not models:
        raise InvalidValueError("against", against, f"one of {sorted({row.against for row in table.rows})}")
    edges = table.config.bins_mm
    centres = [0.5 * (low + high) for low, high in pairwise(edges)]
    with figure_page(path, title=f"Error against working distance ({against})", width_in=10.0, height_in=4.4) as figure:
        axes = figure.subplots(1, 2, sharey=True)
        for axis, which, name in zip(axes, ("every", "valid"), ("all pixels that count", "pixels marked valid"), strict=True):
            for number, model in enumerate(models):
                _draw_line(axis, table, model, against, which, centres, number)
            axis.set_yscale("log")
            axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axis.yaxis.set_minor_formatter(NullFormatter())
            axis.set(title=name, xlabel="median depth of the frame [mm]", xticks=edges)
            draw_grid(axis)
        axes[0].set_ylabel("mean absolute error [mm]")
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside right upper", frameon=False, fontsize=8)


def _draw_line(
    axis: Axes, table: DepthTable, model: str, against: str, which: str, centres: Sequence[float], number: int
) -> None:
    rows = [row for row in table.rows if row.model == model and row.against == against and row.working_distance_mm != "all"]
    values = np.array([getattr(row, which).mae_mm for row in rows])
    interval = [getattr(row, f"{which}_interval") for row in rows]
    low, high = (np.array([getattr(part, end).mae_mm for part in interval]) for end in ("low", "high"))
    floor = model.startswith("photon floor")
    style: dict[str, Any]
    if floor:
        style = {"color": GREY, "linestyle": "--" if model.endswith(" 1 row") else ":", "marker": ".", "linewidth": 1.2}
    elif model == REFERENCE_ROW:
        style = {"color": "black", "linestyle": "-.", "marker": "s", "markersize": 3, "linewidth": 1.2}
    else:
        style = {"color": _MODEL_COLOURS[number % len(_MODEL_COLOURS)], "marker": "o", "markersize": 4, "linewidth": 1.4}
    axis.plot(centres, np.where(values > 0.0, values, np.nan), label=model, **style)
    known = np.isfinite(low) & (low > 0.0)
    if not floor and known.any():
        axis.fill_between(np.array(centres)[known], low[known], high[known], color=style["color"], alpha=0.18, linewidth=0.0)


def _shown(table: DepthTable, count: int) -> list[DepthExample]:
    if not table.examples or count < 1:
        raise InvalidValueError("examples of the evaluation", len(table.examples), "one or more")
    return list(table.examples[:count])


def _truth_name(example: DepthExample) -> str:
    return "Zivid reference" if example.against == "zivid" else "exact depth"


def _depth_limits(example: DepthExample) -> tuple[float, float]:
    """Return the depths that the colours span: nearly all of the truth that counts, and a little more."""
    values = example.truth_mm[example.mask]
    if not values.size:
        return 0.0, 1.0
    low, high = np.percentile(values, (0.5, 99.5))
    return 5.0 * math.floor(low / 5.0), 5.0 * math.ceil(high / 5.0 + 1e-9)


def _masked(values: NDArray[np.float32], mask: NDArray[np.bool_]) -> "np.ma.MaskedArray[Any, np.dtype[np.float32]]":
    return np.ma.masked_array(values, mask=~mask)


def _show_depth(axis: Axes, depth_mm: Any, limits: tuple[float, float]) -> Any:
    return _show(axis, depth_mm, cmap=_DEPTH_COLOURS, vmin=limits[0], vmax=limits[1])


def _show(axis: Axes, values: Any, **options: Any) -> Any:
    axis.set(facecolor=_NOTHING, xticks=[], yticks=[])
    axis.spines[:].set(visible=True, color=GREY, linewidth=0.5)
    return axis.imshow(values, interpolation="nearest", **options)


def _colour_bar(figure: Figure, mappable: Any, axes: Any, label: str, **options: Any) -> None:
    bar = figure.colorbar(mappable, ax=list(axes), fraction=0.03, pad=0.02, aspect=18, **options)
    bar.set_label(label, fontsize=8)
    bar.ax.tick_params(labelsize=7)
