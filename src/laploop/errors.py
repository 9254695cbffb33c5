"""Every error that laploop raises on purpose, and what it has to say where work goes on.

Each class is a `LaploopError` and also the built-in that fits it, so that callers may catch either. A message says what was
wrong, the offending value, and what is allowed.
"""

import contextlib
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Self, TypeVar

ErrorT = TypeVar("ErrorT", bound="LaploopError")


class LaploopError(Exception):
    """Base of every error raised on purpose by laploop; keeps its message when it crosses a process border."""

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle by message, since the subclasses' constructors take other arguments, and with the system's error behind it."""
        context = self.__context__ if type(self.__context__) is OSError else None
        return _rebuilt, (type(self), self.args), {"__context__": context}

    def at(self, place: str, joint: str = ": ") -> Self:
        """Return the same error with the place, such as a field's path, in front of its message."""
        return _rebuilt(type(self), (f"{place}{joint}{self}",))


def _rebuilt(kind: type[ErrorT], arguments: tuple[object, ...]) -> ErrorT:
    error = kind.__new__(kind)
    error.args = arguments
    return error


class InvalidValueError(LaploopError, ValueError):
    """A value lies outside what is allowed."""

    def __init__(self, name: str, value: object, allowed: str) -> None:
        shown = str(value) if isinstance(value, Path) else value
        super().__init__(f"{name} is {shown!r}; allowed: {allowed}")

    def at(self, place: str, joint: str = ".") -> Self:
        """Return the same error with the place in front: the path of the configuration that the named field is in."""
        return super().at(place, joint)


class UnknownNameError(LaploopError, ValueError):
    """A name (of a task, an estimator, a motion, ...) that nobody registered."""

    def __init__(self, kind: str, name: object, available: Iterable[str]) -> None:
        names = sorted(available)
        nearest = get_close_matches(str(name), names, n=1) or get_close_matches(str(name).rpartition(".")[2], names, n=1)
        hint = f"did you mean {nearest[0]!r}? " if nearest else ""
        super().__init__(f"unknown {kind} {name!r}; {hint}available: {', '.join(names)}")


class UsageError(LaploopError, ValueError):
    """A command line that cannot be read."""


class WeightsError(LaploopError, ValueError):
    """Weights that are truncated, of another architecture, or not safetensors."""


class DatasetError(LaploopError, ValueError):
    """A data set that is damaged, of another kind, or made by an older version."""


class MissingFileError(LaploopError, FileNotFoundError):
    """A file that should be there is not."""

    def __init__(self, what: str, path: Path | str, remedy: str) -> None:
        super().__init__(f"{what} not found at {path}; {remedy}")


class OutputError(LaploopError, OSError):
    """An output folder or file that cannot be written."""


class SimulationError(LaploopError, RuntimeError):
    """The physics became invalid (NaN, a MuJoCo warning, an impossible start)."""


class WorkerError(LaploopError, RuntimeError):
    """Worker processes that cannot be started, or one that died."""


class InfeasibleError(LaploopError, RuntimeError):
    """A control problem without a solution inside the limits."""


class LaploopNote(UserWarning):
    """Something done on the user's behalf that the user should know of."""


def check_file(what: str, path: Path | str, remedy: str) -> Path:
    """Return the path of a file that exists, its `~` expanded.

    Raises:
        MissingFileError: If there is no such file, or the path cannot be one.
    """
    # Names that are too long, unknown users and folders that may not be read raise errors of other kinds.
    with contextlib.suppress(OSError, RuntimeError, ValueError):
        found = Path(path).expanduser()
        if found.is_file():
            return found
    raise MissingFileError(what, path, remedy)


def check_range(name: str, value: float, low: float, high: float) -> None:
    """Raise an InvalidValueError unless the value of a field is a number from `low` to `high`."""
    if not low <= value <= high:
        raise InvalidValueError(name, value, f"{low:g} to {high:g}")
