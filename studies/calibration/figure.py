"""Figure of a bench's calibration: misfits and true errors."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from laploop.perception.geometry import transform_points
from laploop.studies.calibration.run import BenchCalibration
from laploop.studies.calibration.truth import TrueResiduals, true_residuals
from laploop.studies.figure_style import BLUE, GREY, ORANGE, RED, draw_grid, draw_limit, figure_page

Array = NDArray[np.float64]

LIMIT_PX = 0.3
LIMIT_DEG = 0.1
LIMIT_MM = 0.5
"""Limits that a good calibration of such a bench meets."""


def draw_calibration(found: BenchCalibration, path: Path | str) -> None:
    """Draw errors by view, misfits of the corners in both cameras, and the true residuals."""
    config, joint = found.config, found.joint
    title = f"Calibration of the bench: {config.views} views a step, preset {config.bench.preset}, seed {config.seed}"
    with figure_page(path, title=title, width_in=11.0, height_in=7.4) as figure:
        halves: Any = figure.subfigures(2, 1, height_ratios=(1.0, 1.15))
        top, bottom = halves
        by_view, truth = top.subplots(1, 2, width_ratios=(1.7, 1.0))
        _draw_views(by_view, found)
        _draw_truth(truth, true_residuals(found))
        on_sensor, of_scope, of_reference = bottom.subplots(1, 3)
        _draw_on_sensor(on_sensor, found)
        in_scope = np.concatenate([joint.own_misfit_px.reshape(-1, 2), joint.scope_misfit_px.reshape(-1, 2)])
        _draw_scatter(of_scope, in_scope, BLUE, f"scope, {len(in_scope)} corners")
        in_reference = joint.reference_misfit_px.reshape(-1, 2)
        _draw_scatter(of_reference, in_reference, ORANGE, f"reference camera, {len(in_reference)} corners")


def _draw_views(axis: Axes, found: BenchCalibration) -> None:
    joint = found.joint
    series: list[tuple[str, Array, str, str]] = [
        ("scope, own views", _by_view(joint.own_misfit_px), BLUE, "o"),
        ("scope, pairs", _by_view(joint.scope_misfit_px), BLUE, "x"),
        ("reference, pairs", _by_view(joint.reference_misfit_px), ORANGE, "x"),
        ("reference, maker's", np.array(found.stereo.reference.view_errors_px), ORANGE, "o"),
    ]
    if found.hand_eye is not None:
        series.append(("scope, on the arm", np.array(found.hand_eye.view_errors_px), GREY, "s"))
    for name, errors, colour, marker in series:
        label = f"{name}: {np.sqrt((errors**2).mean()):.3f} px"
        axis.plot(np.arange(1, len(errors) + 1), errors, marker, color=colour, markersize=4.5, fillstyle="none", label=label)
    draw_limit(axis, LIMIT_PX)
    draw_grid(axis)
    axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    axis.set(
        ylim=(0.0, 1.45 * LIMIT_PX),
        xlabel="view",
        ylabel="reprojection error, rms [px]",
        title="reprojection error of each view",
    )
    axis.legend(ncols=2, frameon=False, fontsize=8, loc="upper left")


def _draw_truth(axis: Axes, residuals: TrueResiduals) -> None:
    """Draw the residuals as fractions of their limits, with their values."""
    rows = [
        ("(R, t): rotation", residuals.stereo.rotation_deg, LIMIT_DEG, "deg"),
        ("(R, t): translation", residuals.stereo.translation_mm, LIMIT_MM, "mm"),
    ]
    if residuals.hand_eye is not None:
        rows += [
            ("hand-eye: rotation", residuals.hand_eye.rotation_deg, LIMIT_DEG, "deg"),
            ("hand-eye: translation", residuals.hand_eye.translation_mm, LIMIT_MM, "mm"),
        ]
    if residuals.projector is not None:
        rows += [("projector: depth at 100 mm, rms", residuals.projector.depth_rms_mm, LIMIT_MM, "mm")]
    for place, (_, value, limit, unit) in enumerate(rows):
        fraction = value / limit
        axis.barh(place, min(fraction, 1.3), color=BLUE if fraction <= 1.0 else RED, height=0.55)
        axis.text(min(fraction, 1.3) + 0.03, place, f"{value:.3f} {unit}", va="center", fontsize=8)
    axis.axvline(1.0, color=GREY, linewidth=0.8, linestyle="--")
    axis.set_yticks(range(len(rows)), [name for name, *_ in rows])
    axis.invert_yaxis()
    limits = f"fraction of the limit ({LIMIT_DEG:g} deg, {LIMIT_MM:g} mm)"
    axis.set(xlim=(0.0, 1.7), xlabel=limits, title="true residuals")


def _draw_on_sensor(axis: Axes, found: BenchCalibration) -> None:
    """Draw the misfits at their place in the scope's picture, enlarged."""
    joint, scope, board = found.joint, found.stereo.scope, found.config.board
    enlarged = 100.0
    for poses, misfit, colour, name in (
        (scope.camera_from_board, joint.own_misfit_px, BLUE, "own views"),
        (joint.scope_from_board, joint.scope_misfit_px, RED, "pairs"),
    ):
        place = np.concatenate([scope.project(transform_points(pose, board.corners)) for pose in poses])
        arrows = misfit.reshape(-1, 2)
        axis.quiver(
            *place.T, *arrows.T, angles="xy", scale_units="xy", scale=1.0 / enlarged, color=colour, width=0.0018, label=name
        )
    k = scope.intrinsics
    axis.set(xlim=(0, k.width), ylim=(k.height, 0), aspect="equal", xlabel="u [px]", ylabel="v [px]")
    axis.set_title(f"scope: misfits in the picture, {enlarged:g} times", pad=18)
    axis.legend(ncols=2, frameon=False, fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 0.985), borderaxespad=0.0)


def _draw_scatter(axis: Axes, misfit: Array, colour: str, name: str) -> None:
    rms = float(np.sqrt((misfit**2).sum(axis=-1).mean()))
    axis.plot(*misfit.T, ".", color=colour, markersize=1.8, alpha=0.5)
    axis.add_patch(Circle((0.0, 0.0), rms, fill=False, color="black", linewidth=1.0))
    axis.axhline(0.0, color=GREY, linewidth=0.5)
    axis.axvline(0.0, color=GREY, linewidth=0.5)
    half = 1.05 * float(np.abs(misfit).max())
    axis.set(xlim=(-half, half), ylim=(half, -half), aspect="equal", title=f"{name}\nrms {rms:.3f} px (circle)")
    axis.set(xlabel="measured minus reprojected, u [px]", ylabel="v [px]")


def _by_view(misfit: Array) -> Array:
    errors: Array = np.sqrt((misfit**2).sum(axis=-1).mean(axis=-1))
    return errors
