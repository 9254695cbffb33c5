"""Work that goes on while the loop does: one job at a time, on a thread of its own, in the order in which it is begun."""

import threading
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Executor, Future, ThreadPoolExecutor
from typing import Any, Generic, TypeVar

from laploop.envs.loop.stage_timer import StageTimer
from laploop.errors import SimulationError

WAIT = "wait"
"""Stage of the main thread in which it waits for work that is not finished."""

ResultT = TypeVar("ResultT")


class BackgroundWorker:
    """A thread for one stage of the loop; the stage's wall time goes to the timer."""

    def __init__(self, stage: str, timer: StageTimer) -> None:
        self._stage = stage
        self._timer = timer
        self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix=stage)
        self._abandoned = False

    def later(self, work: Callable[[], ResultT], *, after: "Pending[Any] | None" = None) -> "Pending[ResultT]":
        """Return the result of `work`, which is begun when it is asked for, or earlier by `Pending.begin`.

        What it needs from another worker comes first; waiting for that is not this stage's time.
        """
        return Pending(self._executor, lambda: self._timed(work, after), self._timer)

    def abandon(self) -> None:
        """Forget all jobs but one that is under way; does not wait for it."""
        self._abandoned = True
        self._executor.shutdown(wait=False, cancel_futures=True)

    def close(self) -> None:
        """Finish the job that is under way, forget those that are not, and end the thread."""
        self.abandon()
        self._executor.shutdown(wait=True)

    def _timed(self, work: Callable[[], ResultT], after: "Pending[Any] | None") -> ResultT:
        if after is not None:
            after.result()
        if self._abandoned:
            raise _over()
        begin = time.perf_counter()
        result = work()
        self._timer.add(self._stage, time.perf_counter() - begin)
        return result


class Pending(Generic[ResultT]):
    """A result that is there as soon as somebody needs it; any thread may ask."""

    def __init__(self, executor: Executor, work: Callable[[], ResultT], timer: StageTimer) -> None:
        self._executor = executor
        self._work: Callable[[], ResultT] | None = work
        self._timer = timer
        self._future: Future[ResultT] | None = None
        self._lock = threading.Lock()

    @property
    def begun(self) -> bool:
        """Whether the work has been begun."""
        return self._future is not None

    def begin(self) -> "Future[ResultT]":
        """Begin the work unless that has been done.

        Raises:
            SimulationError: If the worker is closed.
        """
        with self._lock:
            if self._future is None:
                if self._work is None:
                    raise _over()
                work, self._work = self._work, None
                try:
                    self._future = self._executor.submit(work)
                except RuntimeError:
                    raise _over() from None
            return self._future

    def result(self) -> ResultT:
        """Return the result, or raise the work's own error; for other workers, whose waiting is no loss.

        Raises:
            SimulationError: If the worker was closed before.
        """
        try:
            return self.begin().result()
        except CancelledError:
            raise _over() from None

    def wait(self) -> ResultT:
        """Return the result to the main thread, whose waiting is measured; errors as for `result`."""
        with self._timer.measure(WAIT):
            return self.result()


def _over() -> SimulationError:
    return SimulationError("the episode ended before this image or depth map was computed")
