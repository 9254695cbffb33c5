"""Errors of a depth map, in the literature's terms."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from laploop.errors import InvalidValueError


@dataclass(frozen=True, kw_only=True)
class DepthMetrics:
    """Errors over a set of pixels; all NaN when the set is empty."""

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
    """The same below 1.21."""
    beyond_20mm: float
    """Fraction of pixels more than 20 mm off."""


@dataclass(kw_only=True)
class DepthErrors:
    """Adds up errors over many frames, in double precision, without keeping the pixels."""

    sums: NDArray[np.float64] = field(default_factory=lambda: np.zeros(8))

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
        size = np.abs(error)
        ratio = np.maximum(estimate / truth, truth / np.maximum(estimate, 1e-9))
        self.sums += [
            error.size,
            size.sum(),
            (error**2).sum(),
            error.sum(),
            (size / truth).sum(),
            (ratio < 1.1).sum(),
            (ratio < 1.21).sum(),
            (size > 20.0).sum(),
        ]

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
        self.sums += [
            sigma.size,
            size.sum(),
            (sigma**2).sum(),
            0.0,
            (size / truth).sum(),
            (ndtr(0.1 * relative) - ndtr((1.0 / 1.1 - 1.0) * relative)).sum(),
            (ndtr(0.21 * relative) - ndtr((1.0 / 1.21 - 1.0) * relative)).sum(),
            (2.0 * ndtr(-20.0 / sigma)).sum(),
        ]

    def metrics(self) -> DepthMetrics:
        """Return the metrics over everything counted so far."""
        return _metrics(self.sums)


@dataclass(frozen=True, kw_only=True)
class MetricsInterval:
    """Interval of the metrics over other draws of tissues; NaN where it is unknown."""

    low: DepthMetrics
    high: DepthMetrics


def bootstrap_interval(
    sums: NDArray[np.float64], rng: np.random.Generator, *, resamples: int = 1000, confidence: float = 0.95
) -> MetricsInterval:
    """Bootstrap the metrics over groups (percentile method; Efron and Tibshirani, 1993, section 13.3).

    Whole groups are drawn with replacement, for pixels and frames of one tissue are far from independent. `pixels` of both
    ends is that of the data.

    Args:
        sums: (groups, 8), the `DepthErrors.sums` of each group; groups without pixels are left out.
        rng: Source of the draws: the same state gives the same interval.
        resamples: How many draws.
        confidence: Fraction of the draws between the two ends.

    Raises:
        InvalidValueError: If the number of draws or the confidence is impossible.
    """
    if not isinstance(resamples, int) or resamples < 1:
        raise InvalidValueError("resamples", resamples, "an integer, 1 or more")
    if not 0.0 < confidence < 1.0:
        raise InvalidValueError("confidence", confidence, "above 0 and below 1")
    counted = sums[sums[:, 0] > 0]
    pixels = counted[:, 0].sum() if len(counted) else 0.0
    if len(counted) < 2:
        nothing = _metrics(np.r_[pixels, np.full(7, np.nan)])
        return MetricsInterval(low=nothing, high=nothing)
    draws = rng.multinomial(len(counted), np.full(len(counted), 1.0 / len(counted)), size=resamples) @ counted
    tail = 50.0 * (1.0 - confidence)
    ends = np.percentile(draws[:, 1:] / draws[:, :1], (tail, 100.0 - tail), axis=0)
    low, high = (_metrics(np.r_[pixels, pixels * end]) for end in ends)
    return MetricsInterval(low=low, high=high)


def _metrics(sums: NDArray[np.float64]) -> DepthMetrics:
    pixels = int(sums[0])
    mean = sums / pixels if pixels else np.full(8, np.nan)
    return DepthMetrics(
        pixels=pixels,
        mae_mm=float(mean[1]),
        rmse_mm=float(np.sqrt(mean[2])),
        bias_mm=float(mean[3]),
        abs_rel=float(mean[4]),
        acc_1_1=float(mean[5]),
        acc_1_21=float(mean[6]),
        beyond_20mm=float(mean[7]),
    )


def depth_metrics(estimate_mm: NDArray[np.float32], truth_mm: NDArray[np.float32], mask: NDArray[np.bool_]) -> DepthMetrics:
    """Return the metrics of one frame over the pixels where `mask` holds."""
    errors = DepthErrors()
    errors.add(estimate_mm, truth_mm, mask)
    return errors.metrics()
