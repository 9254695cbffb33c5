"""The last seconds of a scalar signal, thinned to a bounded number of samples."""

from collections import deque

import numpy as np

from laploop.arrays import Array
from laploop.errors import check_range


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
        self._times_ns: deque[int] = deque()
        self._values: deque[float] = deque()

    def clear(self) -> None:
        """Forget all samples."""
        self._times_ns.clear()
        self._values.clear()

    def add(self, time_ns: int, value: float) -> None:
        """Append a sample later than all others, unless it is too close to the last one."""
        if self._times_ns and time_ns - self._times_ns[-1] < self._spacing_ns:
            return
        self._times_ns.append(time_ns)
        self._values.append(value)
        while self._times_ns[0] < time_ns - self._span_ns:
            self._times_ns.popleft()
            self._values.popleft()

    def shift(self, step: float) -> None:
        """Move all values by a step, as if the signal had always been there."""
        self._values = deque(value + step for value in self._values)

    @property
    def covered_s(self) -> float:
        """Time from the first to the last sample."""
        return (self._times_ns[-1] - self._times_ns[0]) * 1e-9 if self._times_ns else 0.0

    def snapshot(self) -> tuple[int, Array, Array]:
        """Return the last sample's time, the times of all in seconds relative to it (n,), and the values (n,)."""
        last_ns = self._times_ns[-1]
        return last_ns, (np.array(self._times_ns) - last_ns) * 1e-9, np.array(self._values)
