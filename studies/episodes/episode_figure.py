"""One episode on one page: the scope's images, the depth estimated from them, and the tip's way to its target."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import matplotlib as mpl
import numpy as np
from matplotlib.colors import Colormap
from matplotlib.figure import SubFigure
from numpy.typing import NDArray

from laploop.envs.recording.episode_log import EpisodeLog
from laploop.envs.recording.recorder import DepthRecord
from laploop.envs.tasks.configs import ReachConfig
from laploop.studies.figure_style import BLUE, GREY, ORANGE, RED, draw_grid, draw_limit, figure_page, hide_frame

SUCCESS_RADIUS_MM = ReachConfig.success_radius_m * 1e3
"""Drawn in the plot of the reach task's target error."""

_ROWS = {1: ("only",), 2: ("start", "end"), 3: ("start", "middle", "end")}
_COLUMNS = ("Stripes", "Depth (estimated)", "Depth (truth)", "Error (estimate - truth)")
_NOTHING = "#d9d9d9"


def draw_episode(log: EpisodeLog, summary: Mapping[str, Any], path: Path | str) -> None:
    """Draw an episode as a PNG.

    Rows show the first, a middle and the last depth frame, if there are any; depth and truth share one scale; grey pixels have
    no value. Below are the target error, the contact force and the trocar errors over time. `summary` has `task`, `perception`,
    `motion`, `seed`, `terminated_by` and, where known, `success` and `target_error_mm`.
    """
    records = log.key_depths()
    height_in = 2.55 * max(len(records), 1) + 4.2
    with figure_page(path, title=_title(summary), width_in=11.0, height_in=height_in) as figure:
        images, plots = cast("list[SubFigure]", figure.subfigures(2, 1, height_ratios=[height_in - 4.25, 3.8]))
        if records:
            _draw_images(images, records)
        _draw_plots(plots, log, SUCCESS_RADIUS_MM if summary["task"] == "reach" else None)


def _title(summary: Mapping[str, Any]) -> str:
    ended = str(summary["terminated_by"])
    in_time = "solved to the end" if summary.get("success") else "time ran out"
    solved = "target reached" if summary["task"] == "reach" else "solved"
    outcome = {"success": solved, "time": in_time}.get(ended, f"stopped: {ended}")
    final = summary.get("target_error_mm", {}).get("final")
    if final is not None:
        outcome += f", final error {final:.2f} mm"
    motion = {"still": "tissue still", "both": "tissue breathing and beating"}.get(
        summary["motion"], f"tissue {summary['motion']}"
    )
    return f"{summary['task']}  |  {summary['perception']}  |  {motion}  |  seed {summary['seed']}  |  {outcome}"


def _draw_images(figure: SubFigure, records: Sequence[DepthRecord]) -> None:
    axes = figure.subplots(len(records), 4, squeeze=False)
    # Tissue fills the grey scale; what is brighter, such as the instrument, is white.
    shown = np.concatenate([record.stripes[record.tissue] for record in records])
    white = float(np.clip(np.percentile(shown, 99.8), 32.0, 255.0)) if shown.size else 255.0
    truths = np.concatenate([record.exact_depth_mm[record.tissue] for record in records])
    truths = truths[np.isfinite(truths)]
    near, far = np.percentile(truths, [0.5, 99.5]) if truths.size else (50.0, 150.0)
    errors = [record.error_mm() for record in records]
    known = np.concatenate([np.abs(error[np.isfinite(error)]) for error in errors])
    # A few outliers must not wash out the colours; the rounding errors of a perfect estimate must not look like noise.
    limit = float(np.clip(np.percentile(known, 98.0), 0.2, 10.0)) if known.size else 1.0
    depth_colors, error_colors = _colors("viridis"), _colors("RdBu")
    for row, (record, error, when) in enumerate(zip(records, errors, _ROWS[len(records)], strict=True)):
        estimate = np.where(record.depth.estimate.valid, record.depth.estimate.depth_mm, np.nan)
        axes[row, 0].imshow(record.stripes, cmap="gray", vmin=0, vmax=white)
        axes[row, 0].set_xlabel(f"white: grey value {white:.0f} of 255")
        axes[row, 1].imshow(estimate, cmap=depth_colors, vmin=near, vmax=far)
        depth = axes[row, 2].imshow(record.exact_depth_mm, cmap=depth_colors, vmin=near, vmax=far)
        difference = axes[row, 3].imshow(error, cmap=error_colors, vmin=-limit, vmax=limit)
        axes[row, 0].set_ylabel(f"{when}, captured at {record.depth.captured_ns * 1e-9:.2f} s")
        seen = error[np.isfinite(error)]
        axes[row, 3].set_xlabel(f"MAE {np.abs(seen).mean():.2f} mm" if seen.size else "nothing valid")
        axes[row, 1].set_xlabel(f"{100.0 * record.depth.estimate.valid.mean():.0f} % valid")
        for axis in axes[row]:
            hide_frame(axis)
    for axis, title in zip(axes[0], _COLUMNS, strict=True):
        axis.set_title(title)
    figure.colorbar(depth, ax=axes[:, 2], label="z-depth [mm]", shrink=0.9, aspect=30)
    figure.colorbar(difference, ax=axes[:, 3], label="error [mm]  (red: too near)", shrink=0.9, aspect=30, extend="both")


def _colors(name: str) -> Colormap:
    return mpl.colormaps[name].with_extremes(bad=_NOTHING)


def _draw_plots(figure: SubFigure, log: EpisodeLog, limit_mm: float | None) -> None:
    target, force, rcm = figure.subplots(3, 1, sharex=True, height_ratios=[3, 2, 1.4])
    times = log.times_s()
    error = log.series("target_error_mm")
    if limit_mm is not None:
        draw_limit(target, limit_mm)
        place: dict[str, Any] = {"xycoords": ("axes fraction", "data"), "ha": "right", "va": "bottom"}
        target.annotate(f"{limit_mm:g} mm", (1.0, limit_mm), color=GREY, **place)
    target.plot(times, error, color=BLUE, linewidth=1.6)
    if np.nanmax(error, initial=0.0) > 0.0:
        target.set_yscale("log")
        target.yaxis.set_major_formatter(mpl.ticker.FormatStrFormatter("%g"))
    target.set_ylabel("target error [mm]")
    force.plot(times, log.series("contact_force_n"), color=RED, linewidth=1.2)
    force.set(ylabel="contact\nforce [N]", ylim=(0.0, _axis_top(log.series("contact_force_n"), at_least=0.1)))
    for arm, color in (("camera", ORANGE), ("tool", BLUE)):
        rcm.plot(times, log.series(f"rcm_error_mm/{arm}"), color=color, linewidth=0.9, label=f"{arm} arm")
    both = np.concatenate([log.series("rcm_error_mm/camera"), log.series("rcm_error_mm/tool")])
    rcm.set(xlabel="simulated time [s]", ylabel="trocar\nerror [mm]", ylim=(0.0, _axis_top(both, at_least=0.01)))
    rcm.legend(loc="lower right", bbox_to_anchor=(1.0, 0.95), frameon=False, ncols=2, borderaxespad=0.0)
    for axis in (target, force, rcm):
        draw_grid(axis)
        axis.margins(x=0.01)
    figure.align_ylabels([target, force, rcm])


def _axis_top(values: NDArray[np.float64], at_least: float) -> float:
    return max(1.15 * float(np.nanmax(values, initial=0.0)), at_least)
