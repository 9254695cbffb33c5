"""Whether the predicted probability of a slip is the rate at which depth slips.

Slips are rare where they matter, so that the bins are narrow near 0: equal steps would put nearly all pixels that an estimator
marks valid into one.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from laploop.errors import InvalidValueError
from laploop.perception.bootstrap import Bounded, bounded
from laploop.perception.reliability import CalibrationBin
from laploop.perception.working_range import SLIP_FRACTION, WORKING_RANGE_MM

Array = NDArray[np.float64]

SLIP_EDGES = (0.0, 0.003, 0.01, 0.05, 0.2, 0.5, 1.0)
"""Of the bins of the predicted probability; up to 0.05 of it a pixel may be valid by default."""


@dataclass(frozen=True, kw_only=True)
class SlipCalibration:
    """Predicted and seen slips of the pixels whose true depth is known, inside of the working range and outside."""

    bins: tuple[CalibrationBin, ...]
    """Of the predicted probability, between `SLIP_EDGES`."""
    every: CalibrationBin
    every_seen: Bounded
    """Its seen rate, with an interval over groups such as scenes."""
    valid: CalibrationBin
    """Of the pixels that the estimator marks valid."""
    valid_seen: Bounded

    @classmethod
    def of_groups(cls, sums: Array, rng: np.random.Generator, *, resamples: int = 1000) -> "SlipCalibration":
        """Return that of the `SlipCounts.sums` of each group, (groups, ...); groups without pixels are not drawn."""
        every_seen, valid_seen = bounded(sums[sums[:, :, 0].any(axis=1)], _seen, rng, resamples=resamples)
        *bins, valid = (_bin(*row) for row in sums.sum(axis=0).tolist())
        every = _bin(*sums[:, :-1].sum(axis=(0, 1)).tolist())
        return cls(bins=tuple(bins), every=every, every_seen=every_seen, valid=valid, valid_seen=valid_seen)


@dataclass(kw_only=True)
class SlipCounts:
    """Adds up predicted and seen slips over many frames, without keeping the pixels."""

    sums: Array = field(default_factory=lambda: np.zeros((len(SLIP_EDGES), 3)))
    """Pixels, predicted probabilities, and slips: a row a bin, the last row for the pixels marked valid."""

    def add(
        self,
        slip: NDArray[np.float32],
        estimate_mm: NDArray[np.float32],
        valid: NDArray[np.bool_],
        truth_mm: NDArray[np.float32],
    ) -> None:
        """Count the pixels of one frame that have a truth; all arrays are (height, width).

        Raises:
            InvalidValueError: If shapes differ.
        """
        shapes = (slip.shape, estimate_mm.shape, valid.shape, truth_mm.shape)
        if len(set(shapes)) > 1:
            raise InvalidValueError("shapes of slip, estimate, valid and truth", shapes, "four equal shapes")
        known = np.isfinite(truth_mm)
        predicted, truth = slip[known].astype(np.float64), truth_mm[known].astype(np.float64)
        beyond = (truth < WORKING_RANGE_MM[0]) | (truth > WORKING_RANGE_MM[1])
        slipped = beyond | (np.abs(estimate_mm[known] - truth) > SLIP_FRACTION * truth)
        place = np.searchsorted(SLIP_EDGES[1:-1], predicted, side="left")
        columns = np.stack([np.ones_like(predicted), predicted, slipped], axis=1)
        for column in range(3):
            self.sums[:-1, column] += np.bincount(place, columns[:, column], minlength=len(SLIP_EDGES) - 1)
        self.sums[-1] += columns[valid[known]].sum(axis=0)


def _bin(pixels: float, predicted: float, seen: float) -> CalibrationBin:
    if not pixels:
        return CalibrationBin(pixels=0, predicted=math.nan, seen=math.nan)
    return CalibrationBin(pixels=int(pixels), predicted=predicted / pixels, seen=seen / pixels)


def _seen(sums: Array) -> Array:
    """Return the seen rates of all pixels and of the valid ones, (draws, 2), of sums (draws, bins and 1, 3)."""
    totals = np.stack([sums[:, :-1].sum(axis=1), sums[:, -1]], axis=1)
    pixels, slips = totals[..., 0], totals[..., 2]
    rates: Array = np.divide(slips, pixels, out=np.full_like(slips, np.nan), where=pixels > 0.0)
    return rates
