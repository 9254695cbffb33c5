"""Worker processes of which each may die without taking the others' work with it."""

from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Generic, TypeVar

from laploop.errors import WorkerError
from laploop.workers import follow_parent

Job = TypeVar("Job")
Result = TypeVar("Result")

ATTEMPTS = 2
"""How often a job is tried whose worker dies."""


def run_in_team(
    work: Callable[[Job], Result],
    jobs: Sequence[Job],
    workers: int,
    done: Callable[[Job, Result], None],
    died: Callable[[Job, str], None],
) -> None:
    """Do jobs and hand over each result as soon as it is there.

    With one worker the jobs are done in this process, one after another. With more, a job whose worker dies is tried once more,
    in a new process, and given up then. Whatever ends this function early also ends the workers.

    Args:
        work: Does one job; picklable with more than one worker, as are the jobs and the results.
        jobs: What to do.
        workers: Number of processes.
        done: Called in this process with each finished job and its result.
        died: Called in this process with each job that is given up, and why.

    Raises:
        WorkerError: If a process cannot be started.
    """
    if workers == 1:
        for job in jobs:
            done(job, work(job))
        return
    waiting = deque((job, 1) for job in jobs)
    team: list[_Member[Job]] = []
    try:
        while waiting or team:
            team += [_Member.start(work, *waiting.popleft()) for _ in range(min(len(waiting), workers - len(team)))]
            busy: dict[Any, _Member[Job]] = {member.connection: member for member in team}
            for connection in wait(list(busy)):
                member = busy[connection]
                if member.deliver(done) and waiting:
                    member.give(*waiting.popleft())
                    continue
                team.remove(member)
                reason = member.end()
                if not member.finished and member.attempt < ATTEMPTS:
                    waiting.append((member.job, member.attempt + 1))
                elif not member.finished:
                    died(member.job, f"its worker process died {member.attempt} times, the last time {reason}")
    finally:
        for member in team:
            member.process.kill()
        for member in team:
            member.end()


@dataclass(kw_only=True)
class _Member(Generic[Job]):
    """One process, and what it does."""

    process: BaseProcess
    connection: Connection
    job: Job
    attempt: int
    finished: bool = False

    @classmethod
    def start(cls, work: Callable[[Any], Any], job: Job, attempt: int) -> "_Member[Job]":
        context = get_context("spawn")  # neither torch's threads nor Warp's kernels survive a fork
        here, there = context.Pipe()
        process = context.Process(target=_serve, args=(work, there))
        try:
            process.start()
        except OSError as error:
            raise WorkerError(f"cannot start a worker process: {error.strerror or error}; use one worker") from error
        there.close()
        member = cls(process=process, connection=here, job=job, attempt=attempt)
        member.give(job, attempt)
        return member

    def give(self, job: Job, attempt: int) -> None:
        self.job, self.attempt, self.finished = job, attempt, False
        # A process that has died already shows at the next wait.
        with suppress(ConnectionError):
            self.connection.send(job)

    def deliver(self, done: Callable[[Job, Any], None]) -> bool:
        """Hand over the result of the job; return whether there was one, or the process has died."""
        try:
            result = self.connection.recv()
        except (EOFError, ConnectionError):
            return False
        if isinstance(result, BaseException):
            raise result
        self.finished = True
        done(self.job, result)
        return True

    def end(self) -> str:
        """Wait for the end of a process that has nothing left to do, and return how it ended."""
        self.connection.close()
        self.process.join()
        code = self.process.exitcode or 0
        return f"by signal {-code}" if code < 0 else f"with exit status {code}"


def _serve(work: Callable[[Any], Any], connection: Connection) -> None:
    follow_parent()
    with suppress(EOFError, ConnectionError):
        while True:
            try:
                result = work(connection.recv())
            except (EOFError, ConnectionError):
                return
            except Exception as error:  # noqa: BLE001  raised again by the parent
                result = error
            connection.send(result)
