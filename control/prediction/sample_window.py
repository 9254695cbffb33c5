"""The last seconds of a scalar signal, thinned to a bounded number of samples."""

import numpy as np
from numpy.typing import NDArray

from laploop.errors import check_range

Array = NDArray[np.float64]


class SampleWindow:
    """Samples (time, value) of the last seconds, at least a minimum time apart; closer ones are left out."""

    def __init__(self, *, span_s: float, spacing_s: float) -> None:
        """Take the length and the least spacing.

        Raises:
            InvalidValueError: If the spacing or the length is out of range.
        """
        check_range("spacing_s", spacing_s, 0.001, 1.0)
        check_range("span_s", span_s, 2.0 * spacing_s, 1000.0)
        self._span_ns = round(span_s * 1e9)
        self._spacing_ns = round(spacing_s * 1e9)
        self._capacity = self._span_ns // self._spacing_ns + 2
        # Twice the room, so that the samples are moved to the front only once in a span.
        self._times_ns = np.zeros(2 * self._capacity, dtype=np.int64)
        self._values = np.zeros(2 * self._capacity)
        self.clear()

    def clear(self) -> None:
        """Forget all samples."""
        self._first = self._end = 0

    def add(self, time_ns: int, value: float) -> None:
        """Append a sample later than all others, unless it is too close to the last one."""
        if self._end > self._first and time_ns - int(self._times_ns[self._end - 1]) < self._spacing_ns:
            return
        if self._end == len(self._values):
            kept = self._end - self._first
            self._times_ns[:kept] = self._times_ns[self._first :]
            self._values[:kept] = self._values[self._first :]
            self._first, self._end = 0, kept
        self._times_ns[self._end] = time_ns
        self._values[self._end] = value
        self._end += 1
        while int(self._times_ns[self._first]) < time_ns - self._span_ns:
            self._first += 1

    def shift(self, step: float) -> None:
        """Move all values by a step, as if the signal had been there always."""
        self._values[self._first : self._end] += step

    @property
    def covered_s(self) -> float:
        """Time from the first to the last sample."""
        if self._end == self._first:
            return 0.0
        return float(self._times_ns[self._end - 1] - self._times_ns[self._first]) * 1e-9

    def snapshot(self) -> tuple[int, Array, Array]:
        """Return the last sample's time, the times of all in seconds relative to it (n,), and copies of the values (n,)."""
        times = self._times_ns[self._first : self._end]
        return int(times[-1]), (times - times[-1]) * 1e-9, self._values[self._first : self._end].copy()
