"""Wall-clock time of each stage of the loop."""

import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np


class StageTimer:
    """Collects durations by stage name; a stage may be measured in parts that make one sample together."""

    def __init__(self) -> None:
        self._samples_s: dict[str, list[float]] = defaultdict(list)
        self._parts_s: dict[str, float] = defaultdict(float)
        self._lap_s: dict[str, float] = defaultdict(float)

    @contextmanager
    def measure(self, stage: str) -> Iterator[None]:
        """Add the duration of the block to the stage's running sample."""
        begin = time.perf_counter()
        try:
            yield
        finally:
            seconds = time.perf_counter() - begin
            self._parts_s[stage] += seconds
            self._lap_s[stage] += seconds

    def complete(self, stage: str) -> None:
        """Close the stage's running sample, if any part of it was measured."""
        if stage in self._parts_s:
            self._samples_s[stage].append(self._parts_s.pop(stage))

    def add(self, stage: str, seconds: float) -> None:
        """Add a whole sample that was measured elsewhere."""
        self._samples_s[stage].append(seconds)
        self._lap_s[stage] += seconds

    def lap_ms(self) -> dict[str, float]:
        """Return the milliseconds that each stage took since the last call; stages that did not run are absent."""
        lap = {stage: seconds * 1e3 for stage, seconds in self._lap_s.items()}
        self._lap_s.clear()
        return lap

    def median_ms(self) -> dict[str, float]:
        """Return the median of each stage in milliseconds."""
        return {stage: float(np.median(samples)) * 1e3 for stage, samples in self._samples_s.items()}
