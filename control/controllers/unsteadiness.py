"""How unsteadily tissue moves, as far as late depth can tell."""

import math

from laploop.arrays import Array

_FIRST_CHANGES = 8
"""Changes that do not count: those of a filter that has just started."""


class Unsteadiness:
    """Root mean square of the changes of a measured velocity, newest first in importance."""

    def __init__(self, time_constant_s: float) -> None:
        """Take the time constant of the exponential mean."""
        self._time_constant_s = time_constant_s
        self._velocity: Array | None = None
        self._captured_ns = 0
        self._changes = 0
        self._mean_square = 0.0

    @property
    def rms_mps(self) -> float:
        """The root mean square, m/s; 0 before enough is known."""
        return math.sqrt(self._mean_square)

    def add(self, velocity: Array, captured_ns: int) -> None:
        """Take in the velocity, (3,) m/s, that the frame captured at this time gave; a frame counts once."""
        if self._velocity is not None and captured_ns > self._captured_ns:
            self._changes += 1
            if self._changes > _FIRST_CHANGES:
                change = velocity - self._velocity
                fraction = 1.0 - math.exp(-(captured_ns - self._captured_ns) * 1e-9 / self._time_constant_s)
                self._mean_square += fraction * (float(change @ change) - self._mean_square)
        if self._velocity is None or captured_ns > self._captured_ns:
            self._velocity, self._captured_ns = velocity.copy(), captured_ns
