"""How far a depth map is from the truth, in the terms of the literature."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

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
    """Share of pixels with max(estimate / truth, truth / estimate) below 1.1."""
    acc_1_21: float
    """The same below 1.21."""
    beyond_20mm: float
    """Share of pixels more than 20 mm off."""


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

    def merge(self, other: "DepthErrors") -> None:
        """Count what another counter has counted as well."""
        self.sums += other.sums

    def metrics(self) -> DepthMetrics:
        """Return the metrics over everything counted so far."""
        pixels = int(self.sums[0])
        mean = self.sums / pixels if pixels else np.full(8, np.nan)
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
