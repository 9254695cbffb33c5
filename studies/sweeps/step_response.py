"""What the return of a disturbed loop to its set point tells: overshoot, and the rate at which its oscillation grows."""

from itertools import pairwise

import numpy as np

from laploop.arrays import Array

_SETTLED = 0.004
"""Fraction of the first deviation below which peaks are the noise of the loop, not its oscillation."""
_SKIPPED = 2
"""Peaks at the begin in which other modes than the slowest still show."""
_LEAST = 4
"""Peaks that a growth rate needs."""


def step_response(time_s: Array, deviation: Array) -> dict[str, float | None]:
    """Measure the response to a deviation from the set point.

    Args:
        time_s: (n,), times.
        deviation: (n, k), from the set point; the direction of the first one counts.

    Returns:
        `overshoot_percent` of the first deviation beyond the set point, and `growth_per_s`, the slope of the logarithm of the
        peaks between zero crossings, positive where the loop is unstable; None without enough peaks.
    """
    first = float(np.linalg.norm(deviation[0]))
    if first == 0.0:
        return {"overshoot_percent": None, "growth_per_s": None}
    along = deviation @ (deviation[0] / first) / first
    return {"overshoot_percent": 100.0 * max(0.0, float(-along.min())), "growth_per_s": _growth(time_s, along)}


def _growth(time_s: Array, along: Array) -> float | None:
    crossings = np.flatnonzero(np.sign(along[1:]) != np.sign(along[:-1])) + 1
    peaks = [begin + int(np.abs(along[begin:end]).argmax()) for begin, end in pairwise(crossings)]
    heights = np.abs(along[peaks]) if peaks else np.zeros(0)
    lost = np.flatnonzero(heights < _SETTLED)
    kept = slice(_SKIPPED, int(lost[0]) if lost.size else None)
    if len(heights[kept]) < _LEAST:
        return None
    return float(np.polyfit(time_s[peaks][kept], np.log(heights[kept]), 1)[0])
