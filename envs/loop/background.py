"""Work that goes on while the loop does: one job at a time, on a thread of its own, in the order in which it is begun."""

import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor, wait
from functools import cache, partial
from typing import Any, Generic, TypeVar

from threadpoolctl import ThreadpoolController

from laploop.envs.loop.stage_timer import StageTimer
from laploop.errors import SimulationError
from laploop.workers import usable_cores

WAIT = "wait"
"""Stage of the main thread in which it waits for work that is not finished."""

ResultT = TypeVar("ResultT")


class BackgroundWorker:
    """A thread for one stage of the loop; the stage's wall time goes to the timer."""

    def __init__(self, stage: str, timer: StageTimer, *, after: "BackgroundWorker | None" = None) -> None:
        """Begin nothing yet; the first job comes after what `after`, an abandoned worker, is still at."""
        self._stage = stage
        self.timer = timer
        self.abandoned = False
        self._begun: Future[Any] | None
        self._before: BackgroundWorker | None
        self._start_executor()
        self._before = after

    def later(self, work: Callable[[], ResultT], *, after: "Pending[Any] | None" = None) -> "Pending[ResultT]":
        """Return the result of `work`, which is begun when it is asked for, or earlier by `Pending.begin`.

        What it needs from another worker comes first; waiting for that is not this stage's time.
        """
        return Pending(self, partial(self._timed, work, after))

    def submit(self, work: Callable[[], ResultT]) -> "Future[ResultT]":
        """Begin work that `later` has prepared.

        Raises:
            SimulationError: If the worker is closed.
        """
        try:
            future = self._executor.submit(work)
        except RuntimeError:
            raise _over() from None
        self._begun = future
        return future

    def settle(self) -> None:
        """Wait for all that has been begun."""
        self._end_before()
        if self._begun is not None:
            # One thread, so that the newest job is the last.
            wait([self._begun])

    def __getstate__(self) -> dict[str, Any]:
        """Return what copies and pickles: a copy has a thread of its own, from its first job on."""
        return {name: value for name, value in vars(self).items() if name not in {"_executor", "_begun", "_before"}}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._start_executor()
        if self.abandoned:
            self.abandon()

    def unfinished(self) -> "BackgroundWorker | None":
        """Return the worker that may be at a job: this one, if it has begun none the one before it, or None."""
        if self._begun is None:
            return self._before
        # One thread, so that the newest job is the last.
        return None if self._begun.done() else self

    def abandon(self) -> None:
        """Forget all jobs but one that is under way; does not wait for it."""
        self.abandoned = True
        self._executor.shutdown(wait=False, cancel_futures=True)

    def close(self) -> None:
        """Finish the job that is under way, forget those that are not, and end the thread."""
        self.abandon()
        self._executor.shutdown(wait=True)
        self._end_before()

    def _end_before(self) -> None:
        # Two threads may come here at once.
        if (before := self._before) is not None:
            before.close()
            self._before = None

    def _start_executor(self) -> None:
        self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix=self._stage, initializer=_leave_a_core)
        self._begun = self._before = None

    def _timed(self, work: Callable[[], ResultT], after: "Pending[Any] | None") -> ResultT:
        self._end_before()
        if after is not None:
            after.result()
        if self.abandoned:
            raise _over()
        begin = time.perf_counter()
        result = work()
        self.timer.add(self._stage, time.perf_counter() - begin)
        return result


class Pending(Generic[ResultT]):
    """A result that is there as soon as somebody needs it; any thread may ask.

    A copy, or a pickle, of one that has been begun waits for its result and holds that; another holds the work, which no thread
    may begin meanwhile: `BackgroundWorker.settle` sees to that.
    """

    def __init__(self, worker: BackgroundWorker, work: Callable[[], ResultT]) -> None:
        self._worker = worker
        self._work: Callable[[], ResultT] | None = work
        self._future: Future[ResultT] | None = None
        self._lock = threading.Lock()

    def __getstate__(self) -> dict[str, Any]:
        result, error = None, None
        if self._future is not None:
            try:
                error = self._future.exception()
            except CancelledError:
                error = _over()
            result = self._future.result() if error is None else None
        work = None if self._worker.abandoned else self._work
        return {"worker": self._worker, "work": work, "begun": self.begun, "result": result, "error": error}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._worker, self._work = state["worker"], state["work"]
        self._lock = threading.Lock()
        self._future = Future() if state["begun"] else None
        if self._future is not None:
            if state["error"] is None:
                self._future.set_result(state["result"])
            else:
                self._future.set_exception(state["error"])

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
                self._future = self._worker.submit(work)
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
        with self._worker.timer.measure(WAIT):
            return self.result()


def _leave_a_core() -> None:
    """Let torch, where it is loaded, compute in this thread on all cores but one, which the loop itself needs.

    With as many threads as cores they wait for each other: on two, `compact` takes 21 ms in place of 13.
    """
    if (torch := sys.modules.get("torch")) is not None:
        # Asking gives this thread torch's own number, which would undo the limit later.
        threads = torch.get_num_threads()
        _thread_pools().limit(limits=min(threads, max(1, usable_cores() - 1)), user_api="openmp")


@cache
def _thread_pools() -> Any:
    """Return what holds the limits; finding the loaded libraries takes 2 ms, and every episode begins new threads."""
    return ThreadpoolController()


def _over() -> SimulationError:
    return SimulationError("the episode ended before this image or depth map was computed")
