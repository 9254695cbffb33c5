"""How long the perception stage takes, in simulated time."""

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from laploop.errors import InvalidValueError, MissingFileError


class LatencyModel(Protocol):
    """A source of service times."""

    def reset(self) -> None:
        """Start over, as at the beginning of an episode."""
        ...

    def sample_ns(self, rng: np.random.Generator) -> int:
        """Return the service time of the next frame."""
        ...


@dataclass(frozen=True, kw_only=True)
class ConstantLatency:
    """Every frame takes the same time."""

    latency_ns: int = 40_000_000

    def __post_init__(self) -> None:
        """Check the time.

        Raises:
            InvalidValueError: If it is negative.
        """
        if self.latency_ns < 0:
            raise InvalidValueError("latency_ns", self.latency_ns, "0 or more")

    def reset(self) -> None:
        """Do nothing: there is no state."""

    def sample_ns(self, rng: np.random.Generator) -> int:  # noqa: ARG002  the protocol's signature
        """Return the constant."""
        return self.latency_ns


@dataclass(frozen=True, kw_only=True)
class LognormalLatency:
    """Service times with a long right tail, as schedulers and shared accelerators show."""

    median_ns: int = 40_000_000
    sigma: float = 0.2
    """Standard deviation of the logarithm."""

    def __post_init__(self) -> None:
        """Check the parameters.

        Raises:
            InvalidValueError: If the median or the spread is out of range.
        """
        if self.median_ns <= 0:
            raise InvalidValueError("median_ns", self.median_ns, "above 0")
        if not 0.0 <= self.sigma <= 3.0:
            raise InvalidValueError("sigma", self.sigma, "0 to 3")

    def reset(self) -> None:
        """Do nothing: the randomness comes from the caller's generator."""

    def sample_ns(self, rng: np.random.Generator) -> int:
        """Draw a service time."""
        return round(self.median_ns * math.exp(self.sigma * rng.standard_normal()))


class TraceLatency:
    """Replays recorded service times in order, starting over at the end."""

    def __init__(self, latencies_ns: Sequence[int]) -> None:
        """Keep a copy of the trace.

        Raises:
            InvalidValueError: If the trace is empty or holds a negative time.
        """
        self._trace = tuple(int(latency) for latency in latencies_ns)
        if not self._trace or min(self._trace) < 0:
            raise InvalidValueError("latencies_ns", list(latencies_ns)[:5], "at least one value, none negative")
        self._next = 0

    @classmethod
    def from_csv(cls, path: Path) -> "TraceLatency":
        """Read a trace from the column `latency_ms` of a CSV file.

        Raises:
            MissingFileError: If there is no such file.
            InvalidValueError: If it has no such column, or a value in it is not a number.
        """
        if not path.is_file():
            raise MissingFileError("latency trace", path, "give the path of a CSV file with a column latency_ms")
        with path.open(newline="") as file:
            rows = list(csv.DictReader(file))
        values = [row.get("latency_ms") for row in rows]
        try:
            return cls([round(float(value) * 1e6) for value in values])  # type: ignore[arg-type]
        except (TypeError, ValueError, OverflowError) as error:
            raise InvalidValueError(f"column latency_ms of {path}", values[:5], "one number of milliseconds a row") from error

    def reset(self) -> None:
        """Go back to the start of the trace."""
        self._next = 0

    def sample_ns(self, rng: np.random.Generator) -> int:  # noqa: ARG002  the protocol's signature
        """Return the next recorded time."""
        latency = self._trace[self._next]
        self._next = (self._next + 1) % len(self._trace)
        return latency
