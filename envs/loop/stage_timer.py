"""Wall-clock time of each stage of the loop."""

import threading
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np


class StageTimer:
    """Collects durations by stage name; a stage may be measured in parts that make one sample together.

    A stage that is measured within another does not count as time of that other, so that what one thread measures adds up to
    its time. Other threads only `add`.
    """

    def __init__(self) -> None:
        self._samples_s: dict[str, list[float]] = defaultdict(list)
        self._parts_s: dict[str, float] = defaultdict(float)
        self._lap_s: dict[str, float] = defaultdict(float)
        self._within_s = 0.0
        self._lock = threading.Lock()

    @contextmanager
    def measure(self, stage: str) -> Iterator[None]:
        """Add the duration of the block to the stage's running sample."""
        before, self._within_s = self._within_s, 0.0
        begin = time.perf_counter()
        try:
            yield
        finally:
            seconds = time.perf_counter() - begin
            own_s = seconds - self._within_s
            self._within_s = before + seconds
            self._parts_s[stage] += own_s
            with self._lock:
                self._lap_s[stage] += own_s

    def complete(self, stage: str) -> float:
        """Close the stage's running sample, if any part of it was measured, and return it in seconds; 0 if none was."""
        if stage not in self._parts_s:
            return 0.0
        sample_s = self._parts_s.pop(stage)
        self._samples_s[stage].append(sample_s)
        return sample_s

    def add(self, stage: str, seconds: float) -> None:
        """Add a whole sample that was measured elsewhere; from any thread."""
        with self._lock:
            self._samples_s[stage].append(seconds)
            self._lap_s[stage] += seconds

    def lap_ms(self) -> dict[str, float]:
        """Return the milliseconds that each stage took since the last call; stages that did not run are absent."""
        with self._lock:
            lap = {stage: seconds * 1e3 for stage, seconds in self._lap_s.items()}
            self._lap_s.clear()
        return lap

    def median_ms(self) -> dict[str, float]:
        """Return the median of each stage in milliseconds."""
        with self._lock:
            return {stage: float(np.median(samples)) * 1e3 for stage, samples in self._samples_s.items()}
