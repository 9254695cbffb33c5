"""Sequences of times and of losses, one an episode: iterators that copy and pickle, and then go on to the same numbers."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from laploop.errors import InvalidValueError


class RepeatedTimes(Iterator[int]):
    """Times that were recorded, over and over again; a single one is the same time, always."""

    def __init__(self, times_ns: Sequence[int]) -> None:
        self._times_ns = times_ns
        self._next = 0

    def __next__(self) -> int:
        time_ns = self._times_ns[self._next]
        self._next = (self._next + 1) % len(self._times_ns)
        return time_ns


class TimesInOrder(Iterator[int]):
    """Times that were recorded, once.

    Raises:
        InvalidValueError: When a time beyond the last is asked for.
    """

    def __init__(self, times_ns: Sequence[int]) -> None:
        self._times_ns = times_ns
        self._next = 0

    def __next__(self) -> int:
        if self._next == len(self._times_ns):
            frames = f"{len(self._times_ns)} time{'s' * (len(self._times_ns) > 1)}"
            allowed = f"loop or shuffle, or a shorter episode: the trace holds {frames}, and the episode needs more"
            raise InvalidValueError("order of the latency trace", "in-order", allowed)
        self._next += 1
        return self._times_ns[self._next - 1]


class ShuffledTimes(Iterator[int]):
    """Times that were recorded, in an order that is drawn anew each time they are used up."""

    def __init__(self, times_ns: Sequence[int], rng: np.random.Generator) -> None:
        self._times_ns = times_ns
        self._rng = rng
        self._order: list[int] = []

    def __next__(self) -> int:
        if not self._order:
            self._order = self._rng.permutation(len(self._times_ns)).tolist()[::-1]
        return self._times_ns[self._order.pop()]


class DrawnTimes(Iterator[int]):
    """Times drawn from a distribution; with a probability, one is the last once more."""

    def __init__(
        self,
        draw_ns: Callable[[np.random.Generator], float],
        rng: np.random.Generator,
        *,
        hold_probability: float,
        longest_ns: int,
    ) -> None:
        """Draw with `draw_ns`, and cut what it returns at 0 and `longest_ns`."""
        self._draw_ns = draw_ns
        self._rng = rng
        self._hold_probability = hold_probability
        self._longest_ns = longest_ns
        self._last_ns: int | None = None

    def __next__(self) -> int:
        held = self._last_ns is not None and self._hold_probability and self._rng.random() < self._hold_probability
        if self._last_ns is None or not held:
            self._last_ns = min(max(round(self._draw_ns(self._rng)), 0), self._longest_ns)
        return self._last_ns


class Losses(Iterator[bool]):
    """Whether one thing after another is lost, each with the same probability."""

    def __init__(self, rate: float, rng: np.random.Generator) -> None:
        self._rate = rate
        self._rng = rng

    def __next__(self) -> bool:
        return bool(self._rng.random() < self._rate)
