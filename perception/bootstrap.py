"""Intervals over other draws of scenes (percentile method; Efron and Tibshirani, 1993, section 13.3).

Whole groups, such as the frames of one scene, are drawn with replacement, for pixels and frames of one scene are far from
independent. What is measured is a function of sums, so that a draw is a sum of the groups' sums.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from laploop.errors import InvalidValueError

Array = NDArray[np.float64]

_NUMBERS = 2**20
"""Sums of so many numbers are held at a time."""


@dataclass(frozen=True, kw_only=True)
class Bounded:
    """A measure between the ends of its 95 % interval; NaN where it is unknown."""

    value: float = math.nan
    low: float = math.nan
    high: float = math.nan


UNKNOWN = Bounded()


def bootstrap_ends(
    sums: Array, measure: Callable[[Array], Array], rng: np.random.Generator, *, resamples: int, confidence: float = 0.95
) -> Array:
    """Return the lower and the upper ends of the measures, (2, measures); NaN with fewer than two groups.

    Args:
        sums: (groups, ...), of each group; all of them are drawn from.
        measure: Takes sums (draws, ...) to measures (draws, measures).
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
    groups = len(sums)
    if groups < 2:
        return np.full((2, measure(sums.sum(axis=0, keepdims=True)).shape[-1]), np.nan)
    times = rng.multinomial(groups, np.full(groups, 1.0 / groups), size=resamples)
    parts = np.array_split(times, math.ceil(resamples * sums[0].size / _NUMBERS))
    values = np.concatenate([measure(np.tensordot(part, sums, 1)) for part in parts if len(part)])
    tail = 50.0 * (1.0 - confidence)
    ends = np.full((2, values.shape[1]), np.nan)
    # A draw may hold no pixel of a kind that few groups have; it says nothing about them.
    known = np.isfinite(values)
    whole = known.all(axis=0)
    ends[:, whole] = np.percentile(values[:, whole], (tail, 100.0 - tail), axis=0)
    for place in np.flatnonzero(known.any(axis=0) & ~whole):
        ends[:, place] = np.percentile(values[known[:, place], place], (tail, 100.0 - tail))
    return ends


def bounded(
    sums: Array, measure: Callable[[Array], Array], rng: np.random.Generator, *, resamples: int = 1000
) -> tuple[Bounded, ...]:
    """Return measures of all groups together with their 95 % intervals; the arguments are those of `bootstrap_ends`."""
    values = measure(sums.sum(axis=0, keepdims=True))[0]
    ends = bootstrap_ends(sums, measure, rng, resamples=resamples)
    return tuple(
        Bounded(value=one_nan(value), low=one_nan(low), high=one_nan(high))
        for value, low, high in zip(values.tolist(), *ends.tolist(), strict=True)
    )


def bounded_ratio(sums: Array, rng: np.random.Generator, *, resamples: int = 1000) -> Bounded:
    """Return the ratio of two sums, (groups, 2), with its interval; groups in which the second is 0 are not drawn."""
    (ratio,) = bounded(sums[sums[:, 1] > 0.0], _ratio, rng, resamples=resamples)
    return ratio


def one_nan(value: float) -> float:
    """Return a number, with one NaN for all, so that the results of two runs compare equal."""
    return math.nan if math.isnan(value) else value


def _ratio(sums: Array) -> Array:
    above, below = sums[:, :1], sums[:, 1:]
    return np.divide(above, below, out=np.full_like(above, np.nan), where=below > 0.0)
