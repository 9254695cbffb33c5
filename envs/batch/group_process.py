"""A group of environments in a process of its own."""

import multiprocessing
import os
import pickle
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from typing import Any, Protocol

from laploop.envs.batch.group import EnvironmentGroup, Outcome
from laploop.errors import WorkerError
from laploop.workers import follow_parent

_PATIENCE_S = 5.0
_STARTING = threading.Lock()


class AskedGroup(Protocol):
    """A group that is asked first and answers later, so that several work at once."""

    def ask(self, name: str, *arguments: Any) -> None:
        """Call a method of the group."""

    def answer(self) -> Outcome:
        """Return what the method returned."""

    def begin_close(self) -> None:
        """Begin to end it, without waiting."""

    def close(self) -> None:
        """End the group."""


class LocalGroup:
    """A group in this process, which works when the answer is asked for."""

    def __init__(self, make: Callable[[], EnvironmentGroup]) -> None:
        self._group = make()
        self._asked: tuple[str, tuple[Any, ...]] = "faces", ()

    def ask(self, name: str, *arguments: Any) -> None:
        """Call a method of the group."""
        self._asked = name, arguments

    def answer(self) -> Outcome:
        """Return what the method returned."""
        name, arguments = self._asked
        outcome: Outcome = getattr(self._group, name)(*arguments)
        return outcome

    def begin_close(self) -> None:
        """Nothing that could be begun."""

    def close(self) -> None:
        """End the group."""
        self._group.close()


class GroupProcess:
    """A group in a process of its own; it ends with this one, in whatever way."""

    def __init__(self, number: int, make: Callable[[], EnvironmentGroup]) -> None:
        """Start the process, which makes the group; ask for nothing before `answer` has returned once.

        Raises:
            WorkerError: If it cannot be started.
        """
        if getattr(multiprocessing.current_process(), "_inheriting", False):
            raise WorkerError("a script that makes environments in worker processes needs `if __name__ == '__main__':`")
        # Spawned, not forked: neither torch's threads nor Warp's kernels survive a fork.
        context = multiprocessing.get_context("spawn")
        self._connection, other = context.Pipe()
        self._process = context.Process(target=_serve, args=(other, make), name=f"laploop-environments-{number}", daemon=True)
        try:
            with _one_thread_each():
                self._process.start()
        except OSError as error:
            raise WorkerError(f"cannot start a process for environments: {error.strerror or error}; use workers=1") from error
        other.close()

    def ask(self, name: str, *arguments: Any) -> None:
        """Call a method of the group.

        Raises:
            WorkerError: If the process has died.
        """
        try:
            self._connection.send((name, arguments))
        except OSError as error:
            raise self._died() from error

    def answer(self) -> Outcome:
        """Return what the method returned; the first time, once the group is made, the faces of its environments.

        Raises:
            WorkerError: If the process has died.
            LaploopError: If the group cannot be made.
        """
        try:
            outcome, error = self._connection.recv()
        except (EOFError, OSError) as lost:
            raise self._died() from lost
        if error is not None:
            raise error
        returned: Outcome = outcome
        return returned

    def begin_close(self) -> None:
        """Ask the process to end."""
        with suppress(OSError, ValueError):
            self._connection.send(("close", ()))

    def close(self) -> None:
        """End the process: wait for it after `begin_close`, or kill it."""
        self._process.join(timeout=_PATIENCE_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._connection.close()

    def _died(self) -> WorkerError:
        self._process.join(timeout=_PATIENCE_S)
        reason = "perhaps for want of memory, or its script lacks `if __name__ == '__main__':`"
        return WorkerError(f"a process of environments died with exit code {self._process.exitcode}, {reason}")


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Give linear algebra and networks of a starting process one thread: there is a process a core already."""
    names = "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"
    with _STARTING:
        before = {name: os.environ.get(name) for name in names}
        os.environ.update(dict.fromkeys(names, "1"))
        try:
            yield
        finally:
            for name, value in before.items():
                if value is None:
                    del os.environ[name]
                else:
                    os.environ[name] = value


def _serve(connection: Connection, make: Callable[[], EnvironmentGroup]) -> None:
    """Make the group, send its faces, then answer calls of its methods until `close`."""
    follow_parent()
    try:
        group = make()
    except Exception as error:  # noqa: BLE001 - raised again in the process that started this one
        connection.send((None, _portable(error)))
        return
    name: str = "faces"
    arguments: tuple[Any, ...] = ()
    while True:
        results, errors = _answer(group, name, arguments)
        try:
            connection.send(((results, errors), None))
        except Exception as error:  # noqa: BLE001 - results that cannot be pickled
            reason = f"{type(error).__name__}: {error}"
            told = WorkerError(f"the answer to {name!r} cannot be sent to another process ({reason}); use workers=1")
            connection.send((({}, dict.fromkeys(results, told)), None))
        if name == "close":
            return
        try:
            name, arguments = connection.recv()
        except EOFError:
            return


def _answer(group: EnvironmentGroup, name: str, arguments: tuple[Any, ...]) -> Outcome:
    """Return what a method returned, its errors such that they can be sent."""
    results, errors = getattr(group, name)(*arguments)
    return results, {number: _portable(error) for number, error in errors.items()}


def _portable(error: Exception) -> Exception:
    """Return the error, or one with its message where it cannot be sent to another process."""
    try:
        pickle.loads(pickle.dumps(error))  # noqa: S301 - our own
    except Exception:  # noqa: BLE001 - exceptions of others do not always pickle
        return WorkerError(f"{type(error).__name__}: {error}")
    return error
