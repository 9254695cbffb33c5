"""Who computes the physics of many theatres at once."""

import itertools
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Protocol

from laploop.envs.theatre.physics_call import PhysicsCall
from laploop.errors import InvalidValueError

MOST_THREADS = 64


class Stepper(Protocol):
    """Does the calls of physics for which theatres wait, a call a theatre.

    Their order is of no consequence: each has a model and data of its own. Another back end, such as one that keeps the data of
    all theatres along a leading dimension on a GPU, takes the place of this one.
    """

    def do(self, calls: Sequence[PhysicsCall], /) -> None:
        """Do all calls; all are done on return."""

    def close(self) -> None:
        """End its threads."""


class ThreadedStepper:
    """Does the calls on CPU threads; MuJoCo computes without Python's lock, so that they run side by side.

    `mujoco.batch.Batch` takes as much CPU time and gives the same bits, but only models of equal layout (the tissues of two
    seeds often differ in it), and no contacts, from which the force on the tip is summed.
    """

    def __init__(self, threads: int = 1) -> None:
        """Start the threads.

        Args:
            threads: Including the caller's own.

        Raises:
            InvalidValueError: If the number of threads is not from 1 to 64.
        """
        self.threads = checked_count("threads", threads, MOST_THREADS)
        self._helpers = ThreadPoolExecutor(max_workers=threads - 1, thread_name_prefix="physics") if threads > 1 else None

    def do(self, calls: Sequence[PhysicsCall], /) -> None:
        """Do all calls; threads take the next one as they get free."""
        if self._helpers is None or len(calls) == 1:
            for call in calls:
                call.do()
            return
        turn = itertools.count()

        def work() -> None:
            while (number := next(turn)) < len(calls):
                calls[number].do()

        helpers = [self._helpers.submit(work) for _ in range(min(self.threads, len(calls)) - 1)]
        work()
        for helper in helpers:
            helper.result()

    def close(self) -> None:
        """End the threads."""
        if self._helpers is not None:
            self._helpers.shutdown()
            self._helpers = None


def checked_count(name: str, count: object, most: int) -> int:
    """Return a number of things.

    Raises:
        InvalidValueError: If it is not an integer from 1 to `most`.
    """
    if isinstance(count, bool) or not isinstance(count, int) or not 1 <= count <= most:
        raise InvalidValueError(name, count, f"an integer, 1 to {most}")
    return count
