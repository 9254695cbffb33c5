"""What a task measures at the ticks that it assesses, and the statistics it reports."""

import numpy as np


class Samples:
    """One quantity over the assessed ticks of an episode; a statistic is None while there are none."""

    def __init__(self) -> None:
        """Start without values."""
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
