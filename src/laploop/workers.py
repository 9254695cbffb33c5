"""Worker processes that never outlive the process that started them."""

import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing import get_context, parent_process, set_start_method
from multiprocessing.connection import wait as wait_for
from typing import TypeVar

from laploop.errors import WorkerError

Job = TypeVar("Job")
Result = TypeVar("Result")

_POLL_S = 0.2


def usable_cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def run_in_workers(
    work: Callable[[Job], Result],
    jobs: Sequence[Job],
    workers: int,
    done: Callable[[Job, Result], None],
    *,
    prepare: Callable[[], None] | None = None,
    waiting: Callable[[], None] | None = None,
) -> None:
    """Do jobs in worker processes and hand over each result as soon as it is there.

    With one worker the jobs are done in this process, one after another. Whatever ends this function early, be it an error in
    a job or in `done` or Ctrl-C, also ends the workers at once, along with all that they started.

    Args:
        work: Does one job; picklable with more than one worker, as are `prepare`, the jobs and the results.
        jobs: What to do.
        workers: Number of processes.
        done: Called in this process with each finished job and its result.
        prepare: Called in each worker process before its first job.
        waiting: Called in this process a few times a second while workers are busy.

    Raises:
        WorkerError: If the processes cannot be started, or one of them dies.
    """
    if workers == 1:
        for job in jobs:
            done(job, work(job))
        return
    with _starting():
        # Spawned, not forked: neither torch's threads nor Warp's kernels survive a fork.
        pool = ProcessPoolExecutor(workers, get_context("spawn"), initializer=_begin, initargs=(prepare,))
    processes = pool._processes  # noqa: SLF001 - Python 3.14 has `kill_workers`, which spares what the workers started
    try:
        with _starting():
            job_of = {pool.submit(work, job): job for job in jobs}
        pending = set(job_of)
        while pending:
            finished, pending = wait(pending, timeout=_POLL_S, return_when=FIRST_COMPLETED)
            for future in sorted(finished, key=lambda future: future.exception() is not None):
                done(job_of[future], future.result())
            if waiting is not None:
                waiting()
    except BaseException as error:
        for group, process in list(processes.items()):
            # A worker that is still starting has no group of its own yet.
            with suppress(ProcessLookupError):
                os.killpg(group, signal.SIGKILL)
            process.kill()
        if isinstance(error, BrokenProcessPool):
            raise WorkerError(
                "a worker process died, perhaps for want of memory; finished work is kept, the same command resumes it"
            ) from error
        raise
    finally:
        pool.shutdown(wait=True)


@contextmanager
def _starting() -> Iterator[None]:
    """Hold Ctrl-C back, which a starting process would answer with a traceback, and say why one cannot be started."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    except (OSError, ImportError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise WorkerError(f"cannot start worker processes: {reason} (is /dev/shm writable?); use one worker") from error
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def follow_parent() -> None:
    """End this process, and whatever it starts, as soon as its parent has ended, in whatever way.

    For a process that `multiprocessing` started. It gets a process group of its own, and leaves Ctrl-C to its parent.
    """
    signal.set_wakeup_fd(-1)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.setpgid(0, 0)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        # Linux could send a signal on the parent's death (PR_SET_PDEATHSIG), but to this process alone.
        wait_for([parent.sentinel])
        os.killpg(os.getpgrp(), signal.SIGKILL)


def _begin(prepare: Callable[[], None] | None) -> None:
    follow_parent()
    # Locks that libraries make here then have no name, which a killed worker would leave behind.
    set_start_method("fork", force=True)
    if prepare is not None:
        prepare()
