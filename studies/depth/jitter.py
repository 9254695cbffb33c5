"""How much depth jitters over time where nothing moves: the same scene under many draws of the camera's noise."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.tissue_config import TissueConfig
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.errors import InvalidValueError
from laploop.perception.estimators.base import checked_estimate
from laploop.perception.estimators.oracle import OracleEstimator
from laploop.perception.geometry import Rig
from laploop.perception.working_range import WORKING_RANGE_MM
from laploop.studies.csv_text import csv_text
from laploop.studies.depth.config import RobustnessConfig
from laploop.studies.depth.evaluation import EstimatorCache
from laploop.studies.depth.table_files import write_texts
from laploop.studies.scenes.frame_conditions import FrameRanges, draw_camera, draw_optics
from laploop.studies.scenes.training_scene import TrainingScene

_STREAM = 179
"""Keeps these scenes apart from those of data sets, theatres and the other conditions."""


@dataclass(frozen=True, kw_only=True)
class JitterRow:
    """One model on all still scenes: standard deviations of depth over the draws of noise, pixel by pixel."""

    model: str
    scenes: int
    images: int
    """Of each scene."""
    pixels: int
    """Lit pixels in the range of depth that the model marks valid in every image."""
    jitter_mm: float
    """Root mean square over the pixels; NaN without any."""
    jitter_median_mm: float
    jitter_p95_mm: float
    """Exceeded by one pixel of twenty."""
    flicker_fraction: float
    """Of the lit pixels in the range: those that are marked valid in some images and not in others."""

    def flat(self) -> dict[str, object]:
        """Return the row as a flat dictionary; what is unknown is None."""
        return {name: None if isinstance(value, float) and math.isnan(value) else value for name, value in asdict(self).items()}


@dataclass(frozen=True, kw_only=True, eq=False)
class StillScene:
    """One scene that does not move."""

    images: tuple[NDArray[np.uint8], ...]
    """The same picture, each with noise of its own."""
    depth_mm: NDArray[np.float32]
    lit: NDArray[np.bool_]


def still_scenes(config: RobustnessConfig, scope: ScopeOptics) -> Iterator[StillScene]:
    """Render one scene a tissue, under the conditions of training and without the instrument."""
    ranges, camera = FrameRanges(), StripeCamera(Rig.from_optics(scope))
    for tissue in range(config.tissues):
        shape, texture, view = (np.random.default_rng([config.seed, _STREAM, use, tissue]) for use in range(3))
        scene = TrainingScene(TissueConfig(), shape)
        camera.attach(scene.model, tissue=scene.tissue, rng=texture)
        scene.reset()
        pose = draw_camera(ranges, scene.mean_height_m, view)
        camera.set_optics(draw_optics(ranges, pose.working_distance_m, view))
        captures = [
            camera.capture(scene.data, pose.world_from_camera, np.random.default_rng([config.seed, _STREAM, 3, tissue, number]))
            for number in range(config.noise_seeds)
        ]
        yield StillScene(
            images=tuple(capture.image for capture in captures), depth_mm=captures[0].depth_mm, lit=captures[0].lit
        )


def measure_jitter(
    models: Sequence[str],
    scope: ScopeOptics,
    *,
    config: RobustnessConfig | None = None,
    weights: Mapping[str, Path] | None = None,
    range_mm: tuple[float, float] = WORKING_RANGE_MM,
    progress: bool = True,
) -> list[JitterRow]:
    """Measure how much each model's depth of a still scene varies with the noise; a monocular baseline is taken raw.

    Raises:
        InvalidValueError: If no model is named.
        UnknownNameError: If a model's name is unknown.
    """
    if not models:
        raise InvalidValueError("models", list(models), "one name or more")
    chosen = config or RobustnessConfig()
    estimators = EstimatorCache(models, weights).all(Rig.from_optics(scope))
    deviations: dict[str, list[NDArray[np.float64]]] = {model: [] for model in models}
    flicker = dict.fromkeys(models, 0)
    counted = 0
    scenes = still_scenes(chosen, scope)
    for scene in track(scenes, "jitter", total=chosen.tissues, console=Console(stderr=True), disable=not progress):
        # NaN fails both comparisons.
        lit = scene.lit & (scene.depth_mm >= range_mm[0]) & (scene.depth_mm <= range_mm[1])
        counted += int(lit.sum())
        for model, estimator in estimators.items():
            if isinstance(estimator, OracleEstimator):
                estimator.see_truth(scene.depth_mm)
            found = [checked_estimate(estimator.estimate(image), image.shape) for image in scene.images]
            valid = np.stack([estimate.valid for estimate in found])
            always = lit & valid.all(axis=0)
            flicker[model] += int((lit & valid.any(axis=0) & ~always).sum())
            depths = np.stack([estimate.depth_mm[always] for estimate in found]).astype(np.float64)
            deviations[model].append(depths.std(axis=0, ddof=1))
    return [_row(model, np.concatenate(deviations[model]), flicker[model] / max(1, counted), chosen) for model in models]


def _row(model: str, deviations: NDArray[np.float64], flicker_fraction: float, config: RobustnessConfig) -> JitterRow:
    some = len(deviations) > 0
    median, p95 = np.percentile(deviations, (50.0, 95.0)).tolist() if some else (math.nan, math.nan)
    return JitterRow(
        model=model,
        scenes=config.tissues,
        images=config.noise_seeds,
        pixels=len(deviations),
        jitter_mm=float(np.sqrt((deviations**2).mean())) if some else math.nan,
        jitter_median_mm=median,
        jitter_p95_mm=p95,
        flicker_fraction=flicker_fraction,
    )


def write_jitter(rows: Sequence[JitterRow], out: Path) -> None:
    """Write `jitter.csv` and `jitter.md` into the folder `out`; raises as `write_texts` does."""
    flat = [row.flat() for row in rows]
    head = "| model | scenes | images each | rms mm | median mm | 95 % below mm | flicker |\n|---|---|---|---|---|---|---|\n"
    body = "".join(
        f"| {row.model} | {row.scenes} | {row.images} | {_number(row.jitter_mm)} | {_number(row.jitter_median_mm)} "
        f"| {_number(row.jitter_p95_mm)} | {100 * row.flicker_fraction:.2f} % |\n"
        for row in rows
    )
    note = (
        "Standard deviation of depth over images of a still scene that differ in their noise alone, over the lit pixels in the "
        "range of depth that are marked valid in all of them; flicker is the fraction of the lit pixels that are marked valid "
        "in some.\n"
    )
    write_texts(out, {"jitter.csv": csv_text(flat[0], (row.values() for row in flat)), "jitter.md": f"{head}{body}\n{note}"})


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.3f}"
