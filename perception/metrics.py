"""Errors of a depth map, in the literature's terms."""

import math
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from laploop.errors import InvalidValueError
from laploop.perception.bootstrap import bootstrap_ends, one_nan
from laploop.perception.surface_measures import SurfaceErrors, with_neighbours
from laploop.perception.working_range import SLIP_FRACTION

_RATIOS = {"acc_1_1": 1.1, "acc_1_21": 1.21, "acc_1_331": 1.331, "acc_1_25": 1.25, "acc_1_5625": 1.5625, "acc_1_953": 1.953125}
_DISTANCES_MM = {"beyond_20mm": 20.0, "beyond_1mm": 1.0, "beyond_2mm": 2.0, "beyond_3mm": 3.0}


@dataclass(frozen=True, kw_only=True)
class DepthMetrics:
    """Errors over a set of pixels; NaN where the set has none, or what a measure needs was not given."""

    pixels: int
    mae_mm: float
    """Mean absolute error."""
    rmse_mm: float
    bias_mm: float
    """Mean of estimate minus truth."""
    abs_rel: float
    """Mean of absolute error over truth."""
    acc_1_1: float
    """Fraction of pixels with max(estimate / truth, truth / estimate) below 1.1."""
    acc_1_21: float
    """The same below 1.1 squared."""
    beyond_20mm: float
    """Fraction of pixels more than 20 mm off."""
    sq_rel_mm: float
    """Mean of squared error over truth."""
    acc_1_331: float
    """Fraction within a ratio of 1.1 cubed."""
    acc_1_25: float
    """Fraction within a ratio of 1.25."""
    acc_1_5625: float
    """Fraction within 1.25 squared."""
    acc_1_953: float
    """Fraction within 1.25 cubed."""
    beyond_1mm: float
    beyond_2mm: float
    beyond_3mm: float
    slips_per_1000: float
    """Of a thousand pixels that were marked valid, at any depth: those more than 10 % off, or outside of the range of depth."""
    plane_mm: float
    """Mean distance of the estimated points from the planes that touch the true surface."""
    normal_deg: float
    """Mean angle between the normals of estimate and truth, from local differences, away from steps of the truth."""
    edge_mae_mm: float
    """Mean absolute error of the pixels at steps of the true depth (`surface_measures`)."""
    away_mae_mm: float
    """The same of all others."""


_NAMES = tuple(metric.name for metric in fields(DepthMetrics) if metric.name != "pixels")

_COLUMNS = (
    *("pixels", "mae_mm", "rmse_mm", "bias_mm", "abs_rel", "acc_1_1", "acc_1_21", "beyond_20mm"),
    *("sq_rel_mm", "acc_1_331", "acc_1_25", "acc_1_5625", "acc_1_953", "beyond_1mm", "beyond_2mm", "beyond_3mm"),
    *("slips_per_1000", "plane_mm", "normal_deg", "edge_mae_mm", "away_mae_mm"),
    *("claimed", "smooth", "edge", "away"),
)
"""What is summed: the numerator of each measure by its name, then the pixels that the last measures are means over."""

SUMS = len(_COLUMNS)
"""Length of a vector of sums."""

_PLACE = {name: place for place, name in enumerate(_COLUMNS)}
_OVER = {
    "slips_per_1000": "claimed",
    "plane_mm": "smooth",
    "normal_deg": "smooth",
    "edge_mae_mm": "edge",
    "away_mae_mm": "away",
}
_NUMERATORS = [_PLACE[name] for name in _NAMES]
_DENOMINATORS = [_PLACE[_OVER.get(name, "pixels")] for name in _NAMES]


@dataclass(kw_only=True)
class DepthErrors:
    """Adds up errors over many frames, in double precision, without keeping the pixels."""

    sums: NDArray[np.float64] = field(default_factory=lambda: np.zeros(SUMS))

    def add(self, estimate_mm: NDArray[np.float32], truth_mm: NDArray[np.float32], mask: NDArray[np.bool_]) -> None:
        """Count the pixels of one frame where `mask` holds.

        Raises:
            InvalidValueError: If shapes differ, or a truth under the mask is not finite and above 0.
        """
        if not estimate_mm.shape == truth_mm.shape == mask.shape:
            shapes = (estimate_mm.shape, truth_mm.shape, mask.shape)
            raise InvalidValueError("shapes of estimate, truth and mask", shapes, "three equal shapes")
        truth = truth_mm[mask].astype(np.float64)
        estimate = estimate_mm[mask].astype(np.float64)
        if not (np.all(np.isfinite(truth)) and np.all(truth > 0.0)):
            raise InvalidValueError("truth under the mask", "not finite or not above 0", "finite depths above 0")
        if not np.all(np.isfinite(estimate)):
            raise InvalidValueError("estimate under the mask", "not finite", "finite depths")
        error = estimate - truth
        size, square = np.abs(error), error**2
        ratio = np.maximum(estimate / truth, truth / np.maximum(estimate, 1e-9))
        self._count(
            pixels=error.size,
            mae_mm=size.sum(),
            rmse_mm=square.sum(),
            bias_mm=error.sum(),
            abs_rel=(size / truth).sum(),
            sq_rel_mm=(square / truth).sum(),
            **{name: np.count_nonzero(ratio < limit) for name, limit in _RATIOS.items()},
            **{name: np.count_nonzero(size > limit) for name, limit in _DISTANCES_MM.items()},
        )

    def add_surface(self, errors: SurfaceErrors, error_mm: NDArray[np.floating], mask: NDArray[np.bool_]) -> None:
        """Count the surface of one frame, with the errors of depth (H, W), where `mask` holds.

        Normals and planes count where it holds for the four neighbours too, whose depths they are made of.
        """
        smooth, edge, away = errors.smooth & with_neighbours(mask), errors.edge & mask, mask & ~errors.edge
        size = np.abs(error_mm, dtype=np.float64)
        self._count(
            plane_mm=errors.plane_mm[smooth].sum(),
            normal_deg=errors.normal_deg[smooth].sum(),
            edge_mae_mm=size[edge].sum(),
            away_mae_mm=size[away].sum(),
            smooth=np.count_nonzero(smooth),
            edge=np.count_nonzero(edge),
            away=np.count_nonzero(away),
        )

    def add_slips(
        self,
        estimate_mm: NDArray[np.float32],
        truth_mm: NDArray[np.float32],
        valid: NDArray[np.bool_],
        range_mm: tuple[float, float],
    ) -> None:
        """Count the slips of one frame among the pixels marked `valid` that have a truth, inside and outside of the range."""
        claimed = valid & np.isfinite(truth_mm)
        truth, estimate = truth_mm[claimed].astype(np.float64), estimate_mm[claimed].astype(np.float64)
        slipped = (np.abs(estimate - truth) > SLIP_FRACTION * truth) | (truth < range_mm[0]) | (truth > range_mm[1])
        self._count(slips_per_1000=1e3 * np.count_nonzero(slipped), claimed=truth.size)

    def add_expected(self, sigma_mm: NDArray[np.floating], truth_mm: NDArray[np.float32], mask: NDArray[np.bool_]) -> None:
        """Count what an unbiased estimate with normal errors of `sigma_mm` (H, W) would score on average where `mask` holds.

        Raises:
            InvalidValueError: If shapes differ, or a sigma or truth under the mask is not finite and above 0.
        """
        if not sigma_mm.shape == truth_mm.shape == mask.shape:
            shapes = (sigma_mm.shape, truth_mm.shape, mask.shape)
            raise InvalidValueError("shapes of sigma, truth and mask", shapes, "three equal shapes")
        sigma, truth = sigma_mm[mask].astype(np.float64), truth_mm[mask].astype(np.float64)
        for name, values in (("sigma", sigma), ("truth", truth)):
            if not (np.all(np.isfinite(values)) and np.all(values > 0.0)):
                raise InvalidValueError(f"{name} under the mask", "not finite or not above 0", "finite values above 0")
        size = math.sqrt(2.0 / math.pi) * sigma
        relative = truth / sigma
        self._count(
            pixels=sigma.size,
            mae_mm=size.sum(),
            rmse_mm=(sigma**2).sum(),
            abs_rel=(size / truth).sum(),
            sq_rel_mm=(sigma / relative).sum(),
            **{
                name: (ndtr((limit - 1.0) * relative) - ndtr((1.0 / limit - 1.0) * relative)).sum()
                for name, limit in _RATIOS.items()
            },
            **{name: (2.0 * ndtr(-limit / sigma)).sum() for name, limit in _DISTANCES_MM.items()},
        )

    def _count(self, **sums: Any) -> None:
        for name, value in sums.items():
            self.sums[_PLACE[name]] += value

    def metrics(self) -> DepthMetrics:
        """Return the metrics over everything counted so far."""
        return _metrics(int(self.sums[0]), _means(self.sums))


@dataclass(frozen=True, kw_only=True)
class MetricsInterval:
    """Interval of the metrics over other draws of tissues; NaN where it is unknown."""

    low: DepthMetrics
    high: DepthMetrics


def bootstrap_interval(
    sums: NDArray[np.float64], rng: np.random.Generator, *, resamples: int = 1000, confidence: float = 0.95
) -> MetricsInterval:
    """Bootstrap the metrics over groups, as `bootstrap_ends` does; `pixels` of both ends is that of the data.

    Args:
        sums: (groups, SUMS), the `DepthErrors.sums` of each group; groups without pixels are left out.
        rng: Source of the draws: the same state gives the same interval.
        resamples: How many draws.
        confidence: Fraction of the draws between the two ends.

    Raises:
        InvalidValueError: If the number of draws or the confidence is impossible.
    """
    counted = sums[sums[:, 0] > 0]
    pixels = int(counted[:, 0].sum())
    low, high = (
        _metrics(pixels, end) for end in bootstrap_ends(counted, _means, rng, resamples=resamples, confidence=confidence)
    )
    return MetricsInterval(low=low, high=high)


def _means(sums: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean of every measure, (..., measures), of sums (..., SUMS); that of the squared errors as it is."""
    counts = sums[..., _DENOMINATORS]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(counts > 0.0, sums[..., _NUMERATORS] / counts, np.nan)


def _metrics(pixels: int, means: NDArray[np.float64]) -> DepthMetrics:
    values = dict(zip(_NAMES, means.tolist(), strict=True))
    values["rmse_mm"] = math.sqrt(values["rmse_mm"])
    return DepthMetrics(pixels=pixels, **{name: one_nan(value) for name, value in values.items()})


def depth_metrics(estimate_mm: NDArray[np.float32], truth_mm: NDArray[np.float32], mask: NDArray[np.bool_]) -> DepthMetrics:
    """Return the metrics of one frame over the pixels where `mask` holds."""
    errors = DepthErrors()
    errors.add(estimate_mm, truth_mm, mask)
    return errors.metrics()
