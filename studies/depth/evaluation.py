"""How well models do on frames of held-out tissues, against exact truth and against the reference camera."""

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from laploop.errors import InvalidValueError
from laploop.perception.cramer_rao import CramerRaoBound
from laploop.perception.data.calibrated_pair_store import CalibratedPairStore
from laploop.perception.data.datasets import DepthDataset, ReferencedDataset, open_dataset
from laploop.perception.estimators.base import DepthEstimator, checked_estimate
from laploop.perception.estimators.monocular import MonocularEstimator, fitted
from laploop.perception.estimators.oracle import OracleEstimator
from laploop.perception.estimators.registry import make_estimator
from laploop.perception.geometry import Rig
from laploop.perception.messages import DepthEstimate
from laploop.perception.metrics import DepthErrors
from laploop.perception.surface_measures import TrueSurface
from laploop.studies.depth.config import DepthEvaluation
from laploop.studies.depth.error_tally import SETS, ErrorTally, FrameGroup
from laploop.studies.depth.reliability_tally import ReliabilityTally
from laploop.studies.depth.table import REFERENCE_ROW, DepthExample, DepthRow, DepthTable, ReliabilityRow
from laploop.studies.depth.table_files import write_table

_SETS = {"exact": ("exact",), "zivid": ("zivid",), "both": ("zivid", "exact-at-zivid", "exact")}
PHASE = "phase"
"""The model whose valid pixels all others are measured on too, where it is among them."""
_KEPT_ESTIMATORS = 16
"""Most rigs of a data set in which every frame has its own for which a model is kept ready."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Truth:
    """What one frame's estimates are measured against."""

    against: str
    depth_mm: NDArray[np.float32]
    mask: NDArray[np.bool_]
    lit: NDArray[np.bool_]
    """Those of the mask that the projector reaches, in the range of depth."""
    surface: TrueSurface


def evaluate_depth(
    dataset: Path,
    models: Sequence[str],
    out: Path | None = None,
    *,
    config: DepthEvaluation | None = None,
    progress: bool = True,
) -> DepthTable:
    """Run models by name over a split of a data set; with `out`, write the table there as JSON, CSV and Markdown.

    Raises:
        InvalidValueError: If no model is named, the split has no frame, or the data set has no reference camera.
        UnknownNameError: If a model's name is unknown.
        MissingFileError: If the data set or a model's weights are missing.
        OutputError: If `out` cannot be written.
    """
    chosen = config or DepthEvaluation()
    if not models or len(set(models)) != len(models):
        raise InvalidValueError("models", list(models), "one name or more, each once")
    strangers = set(chosen.weights) - set(models)
    if strangers:
        raise InvalidValueError("weights for", sorted(strangers), f"models that are evaluated: {', '.join(models)}")
    data = open_dataset(dataset)
    if chosen.against != "exact" and not isinstance(data, CalibratedPairStore):
        raise InvalidValueError("against", chosen.against, f"exact: the data set {dataset} has no reference camera")
    if chosen.against != "zivid" and not data.has_exact:
        raise InvalidValueError("against", chosen.against, f"zivid: the data set {dataset} has no exact depth")
    if "oracle" in models and not data.has_exact:
        raise InvalidValueError("models", "oracle", f"others: the data set {dataset} has no exact depth for it")
    indices = data.indices(chosen.split)
    data.verify(indices)
    estimators = EstimatorCache(models, chosen.weights)
    # All are made before any work starts, so that missing weights are reported at once.
    estimators.all(data.rig(int(indices[0])))
    evaluation = _Evaluation(data, chosen, indices)
    shown = set(_example_indices(data.tissue_seed[indices], indices, chosen.examples))
    for index in track(indices.tolist(), "evaluating", console=Console(stderr=True), disable=not progress):
        evaluation.count(index, estimators.all(data.rig(index)), keep=index in shown)
    rows = evaluation.rows()
    table = DepthTable(
        dataset=dataset.name,
        config=chosen,
        tissues=len(evaluation.tissues),
        frames=len(indices),
        rows=tuple(row for row in rows if row.family == row.texture == "all"),
        family_rows=tuple(row for row in rows if row.family != "all"),
        texture_rows=tuple(row for row in rows if row.texture != "all"),
        reliability=evaluation.reliability_rows(),
        median_ms={name: float(np.median(times)) for name, times in evaluation.times_ms.items()},
        examples=tuple(evaluation.examples),
    )
    if out is not None:
        write_table(table, out)
    return table


class EstimatorCache:
    """The estimators of each rig, made when it is first met and kept for the last ones."""

    def __init__(self, names: Sequence[str], weights: Mapping[str, Path] | None = None) -> None:
        """Name the estimators, and the weights that replace shipped ones."""
        self._names = tuple(names)
        self._weights = dict(weights or {})
        self._by_rig: dict[Rig, dict[str, DepthEstimator]] = {}

    def all(self, rig: Rig) -> dict[str, DepthEstimator]:
        """Return the estimators of a rig, by name."""
        if rig not in self._by_rig:
            if len(self._by_rig) >= _KEPT_ESTIMATORS:
                del self._by_rig[next(iter(self._by_rig))]
            self._by_rig[rig] = {name: make_estimator(name, rig, self._weights.get(name)) for name in self._names}
        return self._by_rig[rig]


class _Evaluation:
    """Adds up the errors of all models, by truth, group of frames and tissue."""

    def __init__(self, data: DepthDataset, config: DepthEvaluation, indices: NDArray[np.intp]) -> None:
        self._data, self._config = data, config
        self.tissues, tissue = np.unique(data.tissue_seed[indices], return_inverse=True)
        self._tissue = dict(zip(map(int, indices), map(int, tissue), strict=True))
        bins = ["all", *(f"{low:g}-{high:g}" for low, high in pairwise(config.bins_mm))]
        self._bins = len(bins)
        families = sorted({data.family(int(index)) for index in indices})
        textures = sorted({data.texture(int(index)) for index in indices})
        # One alone would only repeat the lines of all frames.
        self._named = [FrameGroup(family=name) for name in families if len(families) > 1]
        self._named += [FrameGroup(texture=name) for name in textures if len(textures) > 1]
        groups = [*(FrameGroup(working_distance_mm=name) for name in bins), *self._named]
        self._tally = ErrorTally(groups, len(self.tissues))
        self._floors: dict[Rig, CramerRaoBound] = {}
        self.times_ms: dict[str, list[float]] = {}
        self.examples: list[DepthExample] = []
        self._reliability = ReliabilityTally([name for name in families if len(families) > 1])
        if isinstance(data, CalibratedPairStore):
            self._scope_from_reference = config.residual.apply(data.calibration.scope_from_reference)

    def count(self, index: int, estimators: Mapping[str, DepthEstimator], *, keep: bool) -> None:
        """Measure all models on one frame, and perhaps keep it for the figures."""
        data = self._data
        image = data.image(index)
        exact = data.depth_mm(index) if data.has_exact else None
        known = data.reference_depth_mm(index) if exact is None and isinstance(data, ReferencedDataset) else exact
        distance = math.nan if known is None or np.isnan(known).all() else float(np.nanmedian(known))
        places = self._places(index, distance)
        self._tally.add_frame(places)
        truths = list(self._truths(index, exact))
        sigma_mm = None if exact is None or not self._config.floor_rows else self._floor_mm(index, image, exact)
        predictions = {name: self._predict(name, estimator, image, exact, truths) for name, estimator in estimators.items()}
        by_phase = predictions[PHASE][PHASE][0].valid if PHASE in predictions else None
        for number, truth in enumerate(truths):
            estimates = {row: versions[number] for found in predictions.values() for row, versions in found.items()}
            for row, estimate in estimates.items():
                self._add(row, truth, estimate, by_phase, index, places)
            if truth.against == "exact-at-zivid":
                reference = truths[0].depth_mm
                seen = DepthEstimate(depth_mm=np.nan_to_num(reference), valid=np.isfinite(reference))
                self._add(REFERENCE_ROW, truth, seen, by_phase, index, places)
            if sigma_mm is not None:
                self._add_floors(index, truth, sigma_mm, places)
            if keep and number == 0:
                self.examples.append(
                    DepthExample(
                        index=index,
                        against=truth.against,
                        image=image,
                        truth_mm=truth.depth_mm,
                        mask=truth.mask,
                        estimates=estimates,
                    )
                )

    def rows(self) -> list[DepthRow]:
        """Return the lines of the table, those of families and textures too."""
        config = self._config
        return list(
            self._tally.rows(seed=config.bootstrap_seed, resamples=config.resamples, note=lambda model: _note(model, config))
        )

    def reliability_rows(self) -> tuple[ReliabilityRow, ...]:
        """Return the rows of the models that have a confidence."""
        config = self._config
        return tuple(self._reliability.rows(seed=config.bootstrap_seed, resamples=config.resamples))

    def _places(self, index: int, working_distance_mm: float) -> list[int]:
        """Return the groups of frames that a frame belongs to."""
        place = int(np.searchsorted(self._config.bins_mm, working_distance_mm, side="right"))
        places = [0, place] if 1 <= place < self._bins else [0]
        family, texture = self._data.family(index), self._data.texture(index)
        shown = (group.family == family or group.texture == texture for group in self._named)
        return [*places, *(number for number, one in enumerate(shown, self._bins) if one)]

    def _truths(self, index: int, exact: NDArray[np.float32] | None) -> Iterator[_Truth]:
        wanted, config = _SETS[self._config.against], self._config
        camera = self._data.rig(index).camera
        reachable: NDArray[np.bool_] = np.zeros((camera.height, camera.width), dtype=bool)
        if exact is not None:
            in_range = (exact >= config.nearest_mm) & (exact <= config.farthest_mm)
            reachable = in_range & self._data.lit(index)
            surface = TrueSurface(exact, camera)
        if "zivid" in wanted and isinstance(self._data, CalibratedPairStore):
            if config.residual.nothing:
                reference = self._data.reference_depth_mm(index)
            else:
                reference = self._data.reproject_with(index, self._scope_from_reference).depth_mm
            seen = np.isfinite(reference)
            reference_surface = TrueSurface(reference, camera)
            yield _Truth(against="zivid", depth_mm=reference, mask=seen, lit=seen & reachable, surface=reference_surface)
            if "exact-at-zivid" in wanted and exact is not None:
                both = seen & np.isfinite(exact)
                yield _Truth(against="exact-at-zivid", depth_mm=exact, mask=both, lit=both & reachable, surface=surface)
        if "exact" in wanted and exact is not None:
            yield _Truth(against="exact", depth_mm=exact, mask=in_range, lit=reachable, surface=surface)

    def _predict(
        self,
        name: str,
        estimator: DepthEstimator,
        image: NDArray[np.uint8],
        exact: NDArray[np.float32] | None,
        truths: Sequence[_Truth],
    ) -> dict[str, list[DepthEstimate]]:
        """Return a model's rows: for each its estimate by truth."""
        if isinstance(estimator, OracleEstimator) and exact is not None:
            estimator.see_truth(exact)
        began = time.perf_counter()
        if isinstance(estimator, MonocularEstimator):
            relative = estimator.relative_inverse_depth(image)
            raw = estimator.stretched(relative)
            versions = {
                f"{name} raw": [raw] * len(truths),
                f"{name} fitted": [
                    fitted(relative, truth.depth_mm, truth.mask) if truth.mask.sum() > 1 else raw for truth in truths
                ],
            }
        else:
            versions = {name: [estimator.estimate(image)] * len(truths)}
        self.times_ms.setdefault(name, []).append(1e3 * (time.perf_counter() - began))
        return {row: [checked_estimate(one, image.shape) for one in estimates] for row, estimates in versions.items()}

    def _add(
        self,
        model: str,
        truth: _Truth,
        estimate: DepthEstimate,
        by_phase: NDArray[np.bool_] | None,
        index: int,
        places: Sequence[int],
    ) -> None:
        depth_mm, config = estimate.depth_mm, self._config
        masks = dict(zip(SETS, (truth.mask, truth.mask & estimate.valid, truth.lit), strict=True))
        surface, error_mm = truth.surface.compare(depth_mm), depth_mm - truth.depth_mm
        errors = {}
        for name, mask in masks.items():
            errors[name] = DepthErrors()
            errors[name].add(depth_mm, truth.depth_mm, mask)
            errors[name].add_surface(surface, error_mm, mask)
        errors["valid"].add_slips(depth_mm, truth.depth_mm, estimate.valid, (config.nearest_mm, config.farthest_mm))
        ratios = {"lit_valid_share": _sums(estimate.valid, truth.lit)}
        if by_phase is not None:
            ratios["phase_valid_share"] = _sums(by_phase, truth.mask)
            ratios["phase_valid_mae_mm"] = _sums(np.abs(error_mm), truth.mask & by_phase)
        self._put(model, truth, errors, index, places, ratios)
        family, tissue = self._data.family(index), self._tissue[index]
        self._reliability.add(model, truth.against, estimate, truth.depth_mm, truth.mask, family=family, tissue=tissue)

    def _floor_mm(self, index: int, image: NDArray[np.uint8], exact: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the floor of a window on one row, NaN where the stripes cannot be read."""
        rig = self._data.rig(index)
        if rig not in self._floors:
            self._floors = {rig: CramerRaoBound(rig, self._config.sensor)}
        return np.where(self._data.lit(index), self._floors[rig].sigma_mm(image, exact), np.nan)

    def _add_floors(self, index: int, truth: _Truth, sigma_mm: NDArray[np.float64], places: Sequence[int]) -> None:
        for rows in self._config.floor_rows:
            errors = DepthErrors()
            # Rows are independent: their information adds up.
            errors.add_expected(sigma_mm / math.sqrt(rows), truth.depth_mm, truth.mask & np.isfinite(sigma_mm))
            self._put(floor_name(rows), truth, dict.fromkeys(SETS, errors), index, places, {})

    def _put(
        self,
        model: str,
        truth: _Truth,
        errors: Mapping[str, DepthErrors],
        index: int,
        places: Sequence[int],
        ratios: Mapping[str, tuple[float, float]],
    ) -> None:
        pixels, tissue = int(truth.mask.sum()), self._tissue[index]
        self._tally.add(model, truth.against, errors, ratios=ratios, pixels=pixels, places=places, tissue=tissue)


def _sums(values: NDArray[Any], mask: NDArray[np.bool_]) -> tuple[float, float]:
    """Return the sum of values under a mask, and how many there are."""
    return float(values[mask].sum(dtype=np.float64)), float(mask.sum())


def floor_name(rows: int) -> str:
    """Return what the photon floor's line is called."""
    return f"photon floor, {rows} row{'s' if rows > 1 else ''}"


def _note(model: str, config: DepthEvaluation) -> str:
    if model.startswith("photon floor"):
        sensor = config.sensor
        return (
            "what an unbiased estimate of a sine's phase from a window of one period on "
            f"{model.removeprefix('photon floor, ')} would score with a sensor of {sensor.full_well_electrons:g} electrons "
            f"full well, {sensor.read_noise_electrons:g} electrons read noise and {sensor.bits} bits (Cramér-Rao); all columns "
            "are over the pixels where the stripes can be read, whose fraction is given"
        )
    if model == REFERENCE_ROW:
        return "the reference camera's reprojected depth itself"
    if model.endswith(" raw"):
        return "inverse depth up to scale and shift, stretched to 60-140 mm without any truth"
    if model.endswith(" fitted"):
        return "scale and shift fitted to each image's truth by least squares in inverse depth, on the pixels that count"
    return ""


def _example_indices(tissue_seed: NDArray[np.int64], indices: NDArray[np.intp], count: int) -> list[int]:
    """Choose frames spread over tissues and, within them, over the order in which they were taken."""
    tissues = np.unique(tissue_seed)
    chosen: list[int] = []
    for number in range(count):
        own = indices[tissue_seed == tissues[int((number + 0.5) / count * len(tissues))]]
        # Multiples of the golden ratio spread evenly, however many there are.
        frame = int(own[int(math.modf(0.35 + 0.618034 * number)[0] * len(own))])
        if frame not in chosen:
            chosen.append(frame)
    return chosen
