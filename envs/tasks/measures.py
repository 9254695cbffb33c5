"""What tasks are judged by: named reward terms, and statistics of the assessed ticks."""

import numpy as np


def nearness(error: float, scale: float) -> float:
    """Return a term that falls from 0 without an error to -1 far away: minus tanh of the error over a scale."""
    return -float(np.tanh(error / scale))


class Samples:
    """One quantity over the assessed ticks of an episode; a statistic is None while there are none."""

    def __init__(self) -> None:
        self._values: list[float] = []

    def add(self, value: float) -> None:
        """Take the value of one tick."""
        self._values.append(value)

    def mean(self) -> float | None:
        """Return the mean."""
        return float(np.mean(self._values)) if self._values else None

    def rms(self) -> float | None:
        """Return the root of the mean square."""
        return float(np.sqrt(np.mean(np.square(self._values)))) if self._values else None

    def largest(self) -> float | None:
        """Return the largest magnitude."""
        return float(np.abs(self._values).max()) if self._values else None

    def percentile(self, percent: float) -> float | None:
        """Return a percentile."""
        return float(np.percentile(self._values, percent)) if self._values else None

    def fraction_up_to(self, limit: float) -> float | None:
        """Return the fraction of the values that are at most a limit."""
        return float(np.mean(np.array(self._values) <= limit)) if self._values else None
