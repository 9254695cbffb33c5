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
from laploop.perception.bootstrap import Bounded, bounded
from laploop.perception.working_range import WITHIN_MM

Array = NDArray[np.float64]

TENTHS = 10

_BINS = 1000
"""Of the confidence; pixels in one are admitted together."""


@dataclass(frozen=True, kw_only=True)
class CalibrationBin:
    """Pixels of similar predicted probability, as of one tenth of the confidence."""

    pixels: int
    predicted: float
    """Mean probability; NaN without pixels."""
    seen: float
    """Fraction of which what was predicted is true."""


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
        return float(_scores(self.sums[np.newaxis])[0, 0])

    @property
    def calibration_error(self) -> float:
        """Mean difference of predicted and seen rate over all pixels, by tenths (ECE); NaN without pixels."""
        return float(_scores(self.sums[np.newaxis])[0, 1])

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


def bounded_scores(sums: Array, rng: np.random.Generator, *, resamples: int = 1000) -> tuple[Bounded, Bounded]:
    """Return AURC (mm) and calibration error with their intervals over groups such as scenes.

    `sums` are the `ReliabilityErrors.sums` of each group, (groups, ...); groups without pixels are not drawn.
    """
    aurc_mm, calibration_error = bounded(sums[sums[:, :, 0].any(axis=1)], _scores, rng, resamples=resamples)
    return aurc_mm, calibration_error


def _scores(sums: Array) -> Array:
    """Return AURC and calibration error, (draws, 2), of sums (draws, bins, 4)."""
    falling = np.cumsum(sums[:, ::-1, :2], axis=1)
    risk = np.divide(falling[..., 1], falling[..., 0], out=np.zeros_like(falling[..., 0]), where=falling[..., 0] > 0.0)
    tenths = sums.reshape(len(sums), TENTHS, -1, 4).sum(axis=2)
    totals = np.stack([(sums[:, ::-1, 0] * risk).sum(axis=1), np.abs(tenths[..., 3] - tenths[..., 2]).sum(axis=1)], axis=1)
    pixels = falling[:, -1:, 0]
    scores: Array = np.divide(totals, pixels, out=np.full_like(totals, np.nan), where=pixels > 0.0)
    return scores
