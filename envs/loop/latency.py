"""How long the perception stage takes, in simulated time.

A model is a specification without state; `samples_ns` begins one sequence of service times, which belongs to its episode.
"""

import csv
import math
from collections.abc import Iterator
from itertools import cycle, repeat
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from laploop.configuration import Field, configuration
from laploop.errors import InvalidValueError, check_file

COLUMN = "latency_ms"
"""Of a trace file, as `laploop speed` writes it."""

Milliseconds = Annotated[float, Field(ge=0.0, le=5000.0)]

_LARGEST_FILE = 64 * 2**20
_LONGEST_SHOWN = 40


@configuration
class ConstantLatency:
    """Every frame takes the same time."""

    kind: Literal["constant"] = "constant"
    """The same for every frame, drawn from a log-normal distribution, or replayed from a trace."""
    latency_ms: Milliseconds = 40.0
    """Service time of a frame."""

    def samples_ns(self, rng: np.random.Generator) -> Iterator[int]:  # noqa: ARG002  the same for all models
        """Yield the service time of one frame after another."""
        return repeat(_nanoseconds(self.latency_ms))


@configuration
class LognormalLatency:
    """Service times with a long right tail, as schedulers and shared accelerators show."""

    kind: Literal["lognormal"] = "lognormal"
    median_ms: Annotated[float, Field(gt=0.0, le=5000.0)] = 40.0
    """Median of the service times."""
    sigma: Annotated[float, Field(ge=0.0, le=3.0)] = 0.2
    """Standard deviation of the logarithm."""

    def samples_ns(self, rng: np.random.Generator) -> Iterator[int]:
        """Yield the service time of one frame after another, drawn from `rng`."""
        while True:
            yield round(_nanoseconds(self.median_ms) * math.exp(self.sigma * rng.standard_normal()))


@configuration
class TraceLatency:
    """Replays recorded service times in order, starting over at the end."""

    kind: Literal["trace"] = "trace"
    latencies_ms: Annotated[tuple[Milliseconds, ...], Field(min_length=1, max_length=1_000_000)]
    """The recorded times; `--latency-trace FILE` reads them from a CSV file."""

    @classmethod
    def from_csv(cls, path: Path | str) -> "TraceLatency":
        """Read a trace from the column `latency_ms` of a CSV file in UTF-8.

        Raises:
            MissingFileError: If there is no such file.
            InvalidValueError: If it is not such a file, or a row has no such number or another number of columns.
        """
        path = check_file("latency trace", path, f"give the path of a CSV file with a column {COLUMN}")
        name = f"latency trace {path}"
        if (size := path.stat().st_size) > _LARGEST_FILE:
            raise InvalidValueError(name, f"{size} bytes", f"at most {_LARGEST_FILE}")
        try:
            rows = list(csv.reader(path.read_text(encoding="utf-8-sig").rstrip().splitlines(), strict=True))
        except (UnicodeDecodeError, csv.Error) as error:
            raise InvalidValueError(name, _cut(str(error)), "a CSV file, text in UTF-8") from error
        if len(rows) < 2 or COLUMN not in rows[0]:
            header = _cut(",".join(rows[0]) if rows else "")
            raise InvalidValueError(name, header, f"a line of column names, {COLUMN} among them, and at least one row")
        column, width = rows[0].index(COLUMN), len(rows[0])
        return cls(latencies_ms=tuple(_entry(row, column, width, f"line {n} of {name}") for n, row in enumerate(rows[1:], 2)))

    def samples_ns(self, rng: np.random.Generator) -> Iterator[int]:  # noqa: ARG002  the same for all models
        """Yield the service time of one frame after another."""
        return cycle([_nanoseconds(latency) for latency in self.latencies_ms])


LatencyModel = ConstantLatency | LognormalLatency | TraceLatency


def _nanoseconds(milliseconds: float) -> int:
    return round(milliseconds * 1e6)


def _entry(row: list[str], column: int, width: int, place: str) -> float:
    try:
        value = float(row[column]) if len(row) == width else math.nan
    except ValueError:
        value = math.nan
    if not 0.0 <= value <= 5000.0:
        allowed = f"{width} column{'s' * (width > 1)}, {COLUMN} a number from 0 to 5000"
        raise InvalidValueError(place, _cut(",".join(row)), allowed)
    return value


def _cut(text: str) -> str:
    return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."
