"""Measurements of several processes in turns, so that what slows the machine slows all of them."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Protocol

import numpy as np

from laploop.studies.timing.probe_process import Sample


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Median and quartiles of what rounds gave."""

    median: float
    p25: float
    p75: float
    rounds: int

    @classmethod
    def of(cls, values: Sequence[float]) -> "Spread":
        """Make it from the value of each round."""
        p25, median, p75 = np.percentile(values, [25, 50, 75])
        return cls(median=float(median), p25=float(p25), p75=float(p75), rounds=len(values))

    @classmethod
    def of_ratio(cls, ours: Sequence[float], others: Sequence[float]) -> "Spread":
        """Make it from the ratio of each round."""
        return cls.of([mine / other for mine, other in zip(ours, others, strict=True)])

    def as_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return asdict(self)


class Measured(Protocol):
    """Whatever measures a block of work at a time."""

    def block(self, number: int, /) -> Sample:
        """Measure a block; they are numbered from 0."""


def in_turns(probes: Mapping[str, Measured], rounds: int, *, warm_up: bool = True) -> dict[str, list[Sample]]:
    """Let every probe measure one block a round what it has prepared; one probe measures while the others idle.

    Every other round the order is reversed, so that neither a slow drift nor a neighbour's heat favours one of them. A first
    block of each warms up and is not counted.
    """
    samples: dict[str, list[Sample]] = {name: [] for name in probes}
    for number in range(rounds + warm_up):
        names = list(probes)[:: 1 if number % 2 == 0 else -1]
        for name in names:
            sample = probes[name].block(number)
            if number >= warm_up:
                samples[name].append(sample)
    return samples
