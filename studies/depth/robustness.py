"""Errors of models outside of their training set, and whether their confidence shows them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from laploop.assets.scope_optics import ScopeOptics
from laploop.errors import InvalidValueError
from laploop.perception.estimators.base import checked_estimate
from laploop.perception.estimators.oracle import OracleEstimator
from laploop.perception.geometry import Rig
from laploop.perception.messages import DepthEstimate
from laploop.perception.metrics import SUMS, DepthErrors, DepthMetrics, MetricsInterval, bootstrap_interval
from laploop.perception.working_range import WORKING_RANGE_MM
from laploop.studies.csv_text import csv_text
from laploop.studies.depth.config import RobustnessConfig
from laploop.studies.depth.evaluation import EstimatorCache
from laploop.studies.depth.robustness_scenes import CONDITIONS, NOMINAL, OTHER_TISSUE, robustness_frames
from laploop.studies.depth.smooth_fill import fill_smoothly
from laploop.studies.depth.table_files import write_texts

SURROUNDINGS = "exact, unlit filled in"
"""In the table, a model that knows the exact depth of all that the projector reaches, and of the rest only that a
surface bends little: what a condition costs by hiding parts of the view."""

_SETS = 6
"""Errors of: all pixels in the range of depth; those of them that the model marks valid; all that it marks valid; those in the
range that the projector lights; those of the last whose depth the nominal frame shows too, lit; the nominal frame's on them."""

_SAME_MM = 0.001
"""Depths that differ by less are one and the same surface's."""


@dataclass(frozen=True, kw_only=True)
class RobustnessRow:
    """One model under one condition."""

    model: str
    condition: str
    frames: int
    every: DepthMetrics
    """Over all pixels in the range of depth."""
    every_interval: MetricsInterval
    valid: DepthMetrics
    """Over those of them that the model marks valid."""
    valid_interval: MetricsInterval
    claimed: DepthMetrics
    """Over all pixels that the model marks valid, those outside the range of depth too, such as the instrument's."""
    lit: DepthMetrics
    """Over all pixels in the range of depth that the projector reaches: in a shadow there is nothing to read."""
    valid_fraction: float
    """Fraction of the pixels in the range of depth that the model marks valid."""
    ratio: float
    """Mean absolute error of all pixels relative to that of the nominal condition."""
    lit_ratio: float
    """The same for the pixels that the projector reaches."""
    same_ratio: float
    """The same for those of them that show in the nominal frame the same lit point of the same surface, relative to the error
    there: the instrument hides the middle of the view, where depth is easier than at its borders. NaN for another tissue."""
    valid_ratio: float
    """The same for the pixels that the model marks valid."""

    def flat(self) -> dict[str, object]:
        """Return the row as a flat dictionary; what is unknown is None."""
        line: dict[str, object] = {
            "model": self.model,
            "condition": self.condition,
            "frames": self.frames,
            "pixels": self.every.pixels,
            "mae_mm": self.every.mae_mm,
            "mae_mm_low": self.every_interval.low.mae_mm,
            "mae_mm_high": self.every_interval.high.mae_mm,
            "acc_1_1": self.every.acc_1_1,
            "rmse_mm": self.every.rmse_mm,
            "beyond_20mm": self.every.beyond_20mm,
            "ratio": self.ratio,
            "lit_share": self.lit.pixels / max(1, self.every.pixels),
            "lit_mae_mm": self.lit.mae_mm,
            "lit_ratio": self.lit_ratio,
            "same_ratio": self.same_ratio,
            "valid_share": self.valid_fraction,
            "valid_mae_mm": self.valid.mae_mm,
            "valid_mae_mm_low": self.valid_interval.low.mae_mm,
            "valid_mae_mm_high": self.valid_interval.high.mae_mm,
            "valid_ratio": self.valid_ratio,
            "valid_any_depth_mae_mm": self.claimed.mae_mm,
        }
        return {name: None if isinstance(value, float) and math.isnan(value) else value for name, value in line.items()}


def measure_robustness(
    models: Sequence[str],
    scope: ScopeOptics,
    *,
    config: RobustnessConfig | None = None,
    weights: Mapping[str, Path] | None = None,
    range_mm: tuple[float, float] = WORKING_RANGE_MM,
    progress: bool = True,
) -> list[RobustnessRow]:
    """Measure models under every condition against exact truth; a monocular baseline is taken raw.

    The last rows are those of `SURROUNDINGS`.

    Raises:
        InvalidValueError: If no model is named.
        UnknownNameError: If a model's name is unknown.
    """
    if not models:
        raise InvalidValueError("models", list(models), "one name or more")
    chosen = config or RobustnessConfig()
    estimators = EstimatorCache(models, weights)
    # Made before any work starts, so that missing weights are reported at once.
    estimators.all(Rig.from_optics(scope))
    names = [*models, SURROUNDINGS]
    sums = np.zeros((len(CONDITIONS), len(names), _SETS, chosen.tissues, SUMS))
    places = {name: place for place, name in enumerate(CONDITIONS)}
    frames, count = robustness_frames(chosen, scope), len(CONDITIONS) * chosen.frames
    nominal: list[DepthEstimate] = []
    for frame in track(frames, "robustness", total=count, console=Console(stderr=True), disable=not progress):
        truth = frame.depth_mm
        hit = np.isfinite(truth)
        counted = hit & (truth >= range_mm[0]) & (truth <= range_mm[1])
        estimates: list[DepthEstimate] = []
        for estimator in estimators.all(frame.rig).values():
            if isinstance(estimator, OracleEstimator):
                estimator.see_truth(truth)
            estimates.append(checked_estimate(estimator.estimate(frame.image), frame.image.shape))
        # What is nearer than the range, as the instrument, is no part of the surface.
        seen = hit & frame.lit & (truth >= range_mm[0])
        filled = fill_smoothly(truth, seen) if seen.any() else truth
        estimates.append(DepthEstimate(depth_mm=filled.astype(np.float32), valid=seen))
        if frame.condition == NOMINAL:
            usual, nominal = frame, estimates
        lit = counted & frame.lit
        same = lit & usual.lit & (np.abs(truth - usual.depth_mm) < _SAME_MM) & (frame.condition != OTHER_TISSUE)
        for number, (estimate, before) in enumerate(zip(estimates, nominal, strict=True)):
            masks = (counted, counted & estimate.valid, hit & estimate.valid, lit, same)
            for which, (made, mask) in enumerate([*((estimate, mask) for mask in masks), (before, same)]):
                errors = DepthErrors()
                errors.add(made.depth_mm, truth, mask)
                sums[places[frame.condition], number, which, frame.tissue] += errors.sums
    return [
        _row(model, condition, sums[place, number], sums[0, number], chosen)
        for number, model in enumerate(names)
        for condition, place in places.items()
    ]


def _row(
    model: str, condition: str, sums: NDArray[np.float64], nominal: NDArray[np.float64], config: RobustnessConfig
) -> RobustnessRow:
    every, valid, claimed, lit, same, before = (DepthErrors(sums=part.sum(axis=0)).metrics() for part in sums)
    usual = [DepthErrors(sums=part.sum(axis=0)).metrics().mae_mm for part in nominal]
    intervals = [bootstrap_interval(part, np.random.default_rng(config.seed)) for part in sums[:2]]
    return RobustnessRow(
        model=model,
        condition=condition,
        frames=config.frames,
        every=every,
        every_interval=intervals[0],
        valid=valid,
        valid_interval=intervals[1],
        claimed=claimed,
        lit=lit,
        valid_fraction=valid.pixels / max(1, every.pixels),
        ratio=_ratio(every, usual[0], model),
        lit_ratio=_ratio(lit, usual[3], model),
        same_ratio=_ratio(same, before.mae_mm, model) if same.pixels else math.nan,
        valid_ratio=_ratio(valid, usual[1], model),
    )


def _ratio(errors: DepthMetrics, usual: float, model: str) -> float:
    return errors.mae_mm / usual if usual > 0.0 and model != SURROUNDINGS else math.nan


def write_robustness(rows: Sequence[RobustnessRow], out: Path) -> None:
    """Write `robustness.csv` and `robustness.md` into the folder `out`; raises as `write_texts` does."""
    flat = [row.flat() for row in rows]
    text = csv_text(flat[0], (row.values() for row in flat))
    write_texts(out, {"robustness.csv": text, "robustness.md": robustness_markdown(rows)})


def robustness_markdown(rows: Sequence[RobustnessRow]) -> str:
    """Return the rows as a Markdown table, with what each condition is."""
    head = (
        "| model | condition | frames | MAE mm | to nominal | lit | MAE mm, lit | to nominal | to nominal, same pixels "
        "| marked valid | MAE mm, marked valid | the same at any depth |\n|---|---|---|---|---|---|---|---|---|---|---|---|\n"
    )
    body = "".join(
        f"| {row.model} | {row.condition} | {row.frames} | {_number(row.every.mae_mm)} | {_number(row.ratio)} "
        f"| {100 * row.lit.pixels / max(1, row.every.pixels):.1f} % | {_number(row.lit.mae_mm)} "
        f"| {_number(row.lit_ratio)} | {_number(row.same_ratio)} "
        f"| {100 * row.valid_fraction:.1f} % | {_number(row.valid.mae_mm)} | {_number(row.claimed.mae_mm)} |\n"
        for row in rows
    )
    meanings = "".join(f"- {name}: {meaning}\n" for name, meaning in CONDITIONS.items())
    return (
        f"{head}{body}\nTissues that no data set holds, against exact truth, pixels in the range of depth; the last column "
        f"also counts what the model marks valid outside of it.\n\n{meanings}"
    )


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.2f}"
