"""Means of episodes and their differences, with intervals from resampled seeds."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from laploop.arrays import Array

RESAMPLES = 2000
"""Percentiles 2.5 and 97.5 then have a standard error of about a fifteenth of the interval's width."""


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A mean with its 95 % interval; equal bounds for a single episode."""

    mean: float
    low: float
    high: float
    count: int
    """Number of episodes behind it."""


def estimate(values: Sequence[float | None]) -> Estimate | None:
    """Return the mean of what was measured, and the percentile bootstrap's 95 % interval; None if nothing was.

    Resampling is seeded: equal values give equal intervals.
    """
    known = np.array([value for value in values if value is not None], dtype=np.float64)
    if not known.size:
        return None
    means = known[_resampled(known.size)].mean(axis=1)
    return _with_interval(float(known.mean()), means, known.size)


def nested_estimate(groups: Sequence[Sequence[float]]) -> Estimate | None:
    """Return the mean over groups of episodes, as of several trainings, with the interval of resampled groups and episodes.

    Episodes of a training share its policy: taken for independent, they would make the interval too narrow.
    """
    known = [np.asarray(group, dtype=np.float64) for group in groups if len(group)]
    if not known:
        return None
    rng = np.random.default_rng([len(known), sum(map(len, known))])
    means = np.empty(RESAMPLES)
    for number in range(RESAMPLES):
        drawn = (known[index] for index in rng.integers(0, len(known), len(known)))
        means[number] = np.mean([rng.choice(group, group.size).mean() for group in drawn])
    return _with_interval(float(np.mean([group.mean() for group in known])), means, sum(map(len, known)))


def difference(values: Sequence[float | None], base: Sequence[float | None], *, paired: bool) -> Estimate | None:
    """Return how much larger the mean is than that of a base; None if either is missing.

    Args:
        values: Of one condition, an episode each.
        base: Of the other.
        paired: Whether equal places have equal seeds; whole pairs are then resampled, and a pair counts only if both were
            measured.
    """
    if paired:
        pairs = zip(values, base, strict=True)
        return estimate([one - other for one, other in pairs if one is not None and other is not None])
    ours, others = (np.array([one for one in side if one is not None], dtype=np.float64) for side in (values, base))
    if not ours.size or not others.size:
        return None
    # Another stream than that of the first side: both are drawn independently.
    means = ours[_resampled(ours.size)].mean(axis=1) - others[_resampled(others.size, stream=1)].mean(axis=1)
    return _with_interval(float(ours.mean() - others.mean()), means, min(ours.size, others.size))


def _resampled(count: int, *, stream: int = 0) -> "np.ndarray[tuple[int, ...], np.dtype[np.int64]]":
    return np.random.default_rng([count, stream]).integers(0, count, (RESAMPLES, count))


def _with_interval(mean: float, means: Array, count: int) -> Estimate:
    low, high = np.percentile(means, [2.5, 97.5])
    return Estimate(mean=mean, low=float(low), high=float(high), count=count)
