"""How long a stage takes, in simulated time.

A model is a specification without state; `samples_ns` begins one sequence of times, which belongs to its episode. Models of
random times may hold the last one with a probability, as a busy machine stays busy for a while.
"""

import csv
import math
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import Annotated, Literal

import numpy as np

from laploop.configuration import Field, configuration
from laploop.envs.loop.timing.latency_samples import DrawnTimes, RepeatedTimes, ShuffledTimes, TimesInOrder
from laploop.errors import InvalidValueError, check_file

COLUMN = "latency_ms"
"""Of a trace file, as `laploop speed` writes it."""

LONGEST_MS = 5000.0
"""No stage takes longer."""

Milliseconds = Annotated[float, Field(ge=0.0, le=LONGEST_MS)]
PositiveMilliseconds = Annotated[float, Field(gt=0.0, le=LONGEST_MS)]

TraceOrder = Literal["in-order", "loop", "shuffle"]

_LARGEST_FILE = 64 * 2**20
_LONGEST_SHOWN = 40


@configuration
class ConstantLatency:
    """The same time, always."""

    kind: Literal["constant"] = "constant"
    """Always the same; drawn from a normal, a log-normal or a gamma distribution; replayed from a trace; or, where the real
    computation can be timed, as long as it took on this machine."""
    latency_ms: Milliseconds = 40.0
    """The time."""

    @property
    def typical_ns(self) -> int:
        """A time that stands for all."""
        return _nanoseconds(self.latency_ms)

    def samples_ns(self, rng: np.random.Generator) -> Iterator[int]:  # noqa: ARG002  the same for all models
        """Yield one time after another, in nanoseconds."""
        return RepeatedTimes((_nanoseconds(self.latency_ms),))


@configuration
class _DrawnLatency:
    """What all random times have in common: cut at 0 and at the maximum."""

    hold_probability: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    """With which the last time is kept instead of drawing another."""
    max_ms: PositiveMilliseconds = LONGEST_MS
    """Longer times are cut to this."""

    def samples_ns(self, rng: np.random.Generator) -> Iterator[int]:
        """Yield one time after another, in nanoseconds, drawn from `rng`."""
        longest_ns = _nanoseconds(self.max_ms)
        return DrawnTimes(self._draw_ns, rng, hold_probability=self.hold_probability, longest_ns=longest_ns)

    def _draw_ns(self, rng: np.random.Generator) -> float:
        """Return one time, before the cut."""
        raise NotImplementedError


@configuration
class NormalLatency(_DrawnLatency):
    """Times spread evenly around a mean."""

    kind: Literal["normal"] = "normal"
    mean_ms: Milliseconds = 40.0
    """Mean, before the cut."""
    sd_ms: Milliseconds = 4.0
    """Standard deviation, before the cut."""

    @property
    def typical_ns(self) -> int:
        """The mean."""
        return _nanoseconds(self.mean_ms)

    def _draw_ns(self, rng: np.random.Generator) -> float:
        return 1e6 * rng.normal(self.mean_ms, self.sd_ms)


@configuration
class LognormalLatency(_DrawnLatency):
    """Times with a long right tail, as schedulers and shared accelerators show."""

    kind: Literal["lognormal"] = "lognormal"
    median_ms: PositiveMilliseconds = 40.0
    """Median."""
    sigma: Annotated[float, Field(ge=0.0, le=3.0)] = 0.2
    """Standard deviation of the logarithm."""

    @property
    def typical_ns(self) -> int:
        """The median."""
        return _nanoseconds(self.median_ms)

    def _draw_ns(self, rng: np.random.Generator) -> float:
        return _nanoseconds(self.median_ms) * math.exp(self.sigma * rng.standard_normal())


@configuration
class GammaLatency(_DrawnLatency):
    """Times of several waits in a row, as on a network."""

    kind: Literal["gamma"] = "gamma"
    mean_ms: PositiveMilliseconds = 40.0
    """Mean."""
    sd_ms: PositiveMilliseconds = 8.0
    """Standard deviation."""

    @property
    def typical_ns(self) -> int:
        """The mean."""
        return _nanoseconds(self.mean_ms)

    def _draw_ns(self, rng: np.random.Generator) -> float:
        shape, scale_ms = (self.mean_ms / self.sd_ms) ** 2, self.sd_ms**2 / self.mean_ms
        return 1e6 * rng.gamma(shape, scale_ms)


@configuration
class TraceLatency:
    """Replays recorded times."""

    kind: Literal["trace"] = "trace"
    latencies_ms: Annotated[tuple[Milliseconds, ...], Field(min_length=1, max_length=1_000_000)]
    """The recorded times; `--latency-trace FILE` reads those of the perception stage from a CSV file."""
    order: TraceOrder = "loop"
    """In order to the end, where the episode has to be over; in order, starting over at the end; or shuffled by the seed, anew
    at every pass."""

    @classmethod
    def from_csv(cls, path: Path | str, *, order: TraceOrder = "loop") -> "TraceLatency":
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
        times = tuple(_entry(row, column, width, f"line {n} of {name}") for n, row in enumerate(rows[1:], 2))
        return cls(latencies_ms=times, order=order)

    @property
    def typical_ns(self) -> int:
        """The median."""
        return _nanoseconds(median(self.latencies_ms))

    def samples_ns(self, rng: np.random.Generator) -> Iterator[int]:
        """Yield one time after another, in nanoseconds.

        Raises:
            InvalidValueError: Beyond the end of a trace that is replayed once, when another time is asked for.
        """
        times_ns = [_nanoseconds(latency) for latency in self.latencies_ms]
        if self.order == "loop":
            return RepeatedTimes(times_ns)
        return ShuffledTimes(times_ns, rng) if self.order == "shuffle" else TimesInOrder(times_ns)


@configuration
class MeasuredLatency:
    """As long as the computation really took on this machine: the one model that makes wall-clock time part of an episode.

    The times are kept; replayed as a trace, they give the same episode to the bit.
    """

    kind: Literal["measured"] = "measured"

    @property
    def typical_ns(self) -> int:
        """Nothing is known beforehand: 0."""
        return 0


LatencyModel = ConstantLatency | NormalLatency | LognormalLatency | GammaLatency | TraceLatency
"""A time that does not depend on what this machine computes."""

ComputationModel = LatencyModel | MeasuredLatency
"""The time of a stage that really computes."""


def measured_ns(seconds: float) -> int:
    """Return a wall-clock time as a trace can hold it."""
    return min(round(seconds * 1e9), _nanoseconds(LONGEST_MS))


def _nanoseconds(milliseconds: float) -> int:
    return round(milliseconds * 1e6)


def _entry(row: list[str], column: int, width: int, place: str) -> float:
    try:
        value = float(row[column]) if len(row) == width else math.nan
    except ValueError:
        value = math.nan
    if not 0.0 <= value <= LONGEST_MS:
        allowed = f"{width} column{'s' * (width > 1)}, {COLUMN} a number from 0 to {LONGEST_MS:g}"
        raise InvalidValueError(place, _cut(",".join(row)), allowed)
    return value


def _cut(text: str) -> str:
    return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."
