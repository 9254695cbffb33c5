"""Wall-clock time of each stage of the loop."""

import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np


class StageTimer:
    """Collects durations by stage name; a stage may be measured in parts that make one sample together."""

    def __init__(self) -> None:
        """Start without samples."""
        self._samples_s: dict[str, list[float]] = defaultdict(list)
        self._parts_s: dict[str, float] = defaultdict(float)

    @contextmanager
    def measure(self, stage: str) -> Iterator[None]:
        """Add the duration of the block to the stage's running sample."""
        begin = time.perf_counter()
        try:
            yield
        finally:
            self._parts_s[stage] += time.perf_counter() - begin

    def complete(self, stage: str) -> None:
        """Close the stage's running sample, if any part of it was measured."""
        if stage in self._parts_s:
            self.add(stage, self._parts_s.pop(stage))

    def add(self, stage: str, seconds: float) -> None:
        """Add a whole sample."""
        self._samples_s[stage].append(seconds)

    def last_ms(self) -> dict[str, float]:
        """Return the newest sample of each stage in milliseconds."""
        return {stage: samples[-1] * 1e3 for stage, samples in self._samples_s.items()}

    def median_ms(self) -> dict[str, float]:
        """Return the median of each stage in milliseconds."""
        return {stage: float(np.median(samples)) * 1e3 for stage, samples in self._samples_s.items()}
