"""What delay does to a loop that follows, in closed form; nothing here is fitted."""

import math
from collections.abc import Sequence

import numpy as np

Sine = tuple[float, float]
"""Amplitude in metres and frequency in hertz."""


def pure_delay_rms_m(sines: Sequence[Sine], delay_s: float) -> float:
    """Return the RMS error of a perfect follower of what it saw a delay ago.

    A sine of amplitude A and frequency f and itself, delayed by tau, differ by a sine of amplitude 2 A sin(pi f tau).
    """
    return math.sqrt(sum(0.5 * (2.0 * a * math.sin(math.pi * f * delay_s)) ** 2 for a, f in sines))


def following_rms_m(sines: Sequence[Sine], delay_s: float, period_s: float, gain_per_s: float) -> float:
    """Return the RMS error of a proportional follower of the newest of frames that arrive late.

    A follower x' = K (r - x) answers a reference as K / (jw + K); the reference is the target as it was a delay and, on
    average, half a frame period ago. So the error's RMS is A / sqrt(2) |1 - exp(-jw (tau + T/2)) K / (jw + K)|.

    Args:
        sines: The target's motion.
        delay_s: From the capture of a frame to its use, tau.
        period_s: Of frames, T.
        gain_per_s: K.
    """
    squares = 0.0
    for amplitude, hertz in sines:
        jw = 2j * math.pi * hertz
        seen = np.exp(-jw * (delay_s + 0.5 * period_s)) * gain_per_s / (jw + gain_per_s)
        squares += 0.5 * amplitude**2 * abs(1.0 - seen) ** 2
    return math.sqrt(squares)


def border_gain_per_s(delay_frames: int, period_s: float) -> float:
    """Return the gain from which x[k+1] = x[k] - K T x[k-d] is unstable.

    On the border z = exp(j phi) solves z^d (z - 1) = -K T, for which phi = pi / (2 d + 1), and |z - 1| = 2 sin(phi / 2).
    """
    return 2.0 * math.sin(math.pi / (4 * delay_frames + 2)) / period_s


def overshoot_percent(gain_delay: float) -> float:
    """Return how far x' = -K x(t - tau), at rest at 1 before, swings beyond 0; 0 up to K tau = 1/e.

    By the method of steps, x(t) is the sum over n, up to t / tau + 1, of (-K)^n (t - (n - 1) tau)^n / n!.
    """
    times = np.arange(0.0, 12.0, 1e-3)
    total = np.zeros(times.size)
    for n in range(14):
        ahead = np.maximum(times - (n - 1), 0.0)
        total += np.where(times >= n - 1, (-gain_delay * ahead) ** n / math.factorial(n), 0.0)
    # Beyond, the sum's terms cancel too badly, and the first swing is over.
    return 100.0 * max(0.0, float(-total.min()))
