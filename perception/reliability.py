"""Whether an estimator's confidence tells good pixels from bad ones.

Risk against coverage (El-Yaniv and Wiener, 2010): pixels are admitted by falling confidence, and the mean error of those
admitted is drawn against their fraction of all. The area below the curve, AURC, is the mean over all coverages: of two
estimators with the same errors, the one whose confidence sorts them better has the smaller one. Calibration compares the
probability that is predicted with the rate that is seen.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from laploop.errors import InvalidValueError
from laploop.perception.working_range import WITHIN_MM

Array = NDArray[np.float64]

TENTHS = 10

_BINS = 1000
"""Of the confidence; pixels in one are admitted together."""


@dataclass(frozen=True, kw_only=True)
class CalibrationBin:
    """Pixels of one tenth of the confidence."""

    pixels: int
    predicted: float
    """Mean confidence; NaN without pixels."""
    seen: float
    """Fraction within 1 mm."""


@dataclass(kw_only=True)
class ReliabilityErrors:
    """Adds up errors by confidence over many frames, without keeping the pixels."""

    sums: Array = field(default_factory=lambda: np.zeros((_BINS, 4)))
    """Pixels, absolute errors, pixels within 1 mm, and confidences, by bin."""

    def add(
        self,
        confidence: NDArray[np.float32],
        estimate_mm: NDArray[np.float32],
        truth_mm: NDArray[np.float32],
        mask: NDArray[np.bool_],
    ) -> None:
        """Count the pixels of one frame where `mask` holds; all arrays are (height, width).

        Raises:
            InvalidValueError: If shapes differ.
        """
        shapes = (confidence.shape, estimate_mm.shape, truth_mm.shape, mask.shape)
        if len(set(shapes)) > 1:
            raise InvalidValueError("shapes of confidence, estimate, truth and mask", shapes, "four equal shapes")
        chosen = confidence[mask].astype(np.float64)
        size = np.abs(estimate_mm[mask].astype(np.float64) - truth_mm[mask])
        place = np.minimum((chosen * _BINS).astype(np.intp), _BINS - 1)
        for column, weights in enumerate((None, size, (size <= WITHIN_MM).astype(np.float64), chosen)):
            self.sums[:, column] += np.bincount(place, weights, minlength=_BINS)

    @property
    def aurc_mm(self) -> float:
        """Area under risk against coverage, mm; NaN without pixels."""
        coverage, risk = self._curve()
        if not len(coverage):
            return math.nan
        return float((np.diff(coverage, prepend=0.0) * risk).sum())

    @property
    def calibration_error(self) -> float:
        """Mean difference of predicted and seen rate over all pixels, by tenths (ECE); NaN without pixels."""
        bins = [part for part in self.tenths() if part.pixels]
        pixels = sum(part.pixels for part in bins)
        return sum(part.pixels * abs(part.predicted - part.seen) for part in bins) / pixels if pixels else math.nan

    def risk_mm(self, coverages: Array) -> Array:
        """Return the mean absolute error of the most confident pixels at some coverages, from above 0 to 1."""
        coverage, risk = self._curve()
        if not len(coverage):
            return np.full(len(coverages), np.nan)
        return risk[np.minimum(np.searchsorted(coverage, coverages - 1e-12), len(risk) - 1)]

    def tenths(self) -> list[CalibrationBin]:
        """Return predicted and seen rate by tenths of the confidence, the lowest first."""
        pixels, _, within, confidence = self.sums.reshape(TENTHS, -1, 4).sum(axis=1).T
        return [
            CalibrationBin(
                pixels=int(count),
                predicted=total / count if count else math.nan,
                seen=good / count if count else math.nan,
            )
            for count, good, total in zip(pixels.tolist(), within.tolist(), confidence.tolist(), strict=True)
        ]

    def _curve(self) -> tuple[Array, Array]:
        """Return coverage and risk after each bin that has pixels, the most confident first."""
        falling = self.sums[::-1]
        falling = falling[falling[:, 0] > 0.0]
        admitted = np.cumsum(falling[:, 0])
        if not len(admitted):
            return admitted, admitted
        return admitted / admitted[-1], np.cumsum(falling[:, 1]) / admitted
