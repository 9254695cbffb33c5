"""Runs Warp launches in strips, on several CPU threads or at once on CUDA."""

import itertools
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from laploop.errors import InvalidValueError
from laploop.workers import usable_cores

_PIXEL_STRIPS_PER_THREAD = 4
_CUDA_ROW_STRIPS = 16
_CPU_RUN = 256


def launch_run(device: Any) -> int:
    """Return how many elements one of Warp's threads does in a row: on the CPU each thread copies all arguments anew."""
    return _CPU_RUN if device.is_cpu else 1


class StripRunner:
    """Cuts an image into strips and runs launches on them.

    On the CPU, a launch runs on the thread that makes it and releases Python's lock.
    """

    def __init__(self, device: Any, threads: int | None = None) -> None:
        """Use a Warp device; by default with two threads where there are two cores, on CUDA always with one."""
        if threads is None:
            threads = min(2, usable_cores())
        if not 1 <= threads <= 64:
            raise InvalidValueError("threads", threads, "1 to 64")
        self._on_cpu = bool(device.is_cpu)
        self.threads = threads if self._on_cpu else 1
        self._helpers = ThreadPoolExecutor(max_workers=self.threads - 1) if self.threads > 1 else None

    def close(self) -> None:
        """End the helping threads; what is run afterwards takes longer."""
        if self._helpers is not None:
            self._helpers.shutdown()
            self._helpers = None

    def pixel_strips(self, pixels: int) -> list[tuple[int, int]]:
        """Return (first pixel, number of pixels) of strips, several a thread, so that threads finish at about the same time."""
        strips = self.threads * _PIXEL_STRIPS_PER_THREAD if self.threads > 1 else 1
        edges = np.linspace(0, pixels, strips + 1).astype(int)
        return [(int(a), int(b - a)) for a, b in itertools.pairwise(edges)]

    def row_strips(self) -> list[tuple[int, int]]:
        """Return (first strip, number of strips) of each launch: one strip a CPU thread, all strips together on CUDA."""
        return [(strip, 1) for strip in range(self.threads)] if self._on_cpu else [(0, _CUDA_ROW_STRIPS)]

    def run(self, *stages: Sequence[Any]) -> None:
        """Run recorded launches, one a strip and stage; within a strip in order, and all done on return."""
        strips = list(zip(*stages, strict=True))
        turn = itertools.count()

        def work() -> None:
            while (number := next(turn)) < len(strips):
                for launch in strips[number]:
                    launch.launch()

        helpers = [self._helpers.submit(work) for _ in range(self.threads - 1)] if self._helpers is not None else []
        work()
        for helper in helpers:
            helper.result()
