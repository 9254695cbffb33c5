"""The mean of the last numbers of a stream, kept up to date as they come."""

import math
from collections import deque
from itertools import islice


class RecentMean:
    """Keeps the last numbers and their sum, so that the mean costs nothing when it is asked for."""

    def __init__(self, window: int) -> None:
        """Keep at most so many numbers."""
        self._numbers: deque[float] = deque(maxlen=window)
        self._window = window
        self._sum = 0.0
        self._since_exact = 0

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self._numbers)

    def append(self, number: float) -> None:
        """Take in a number; the oldest leaves where there are too many."""
        if len(self._numbers) == self._window:
            self._sum -= self._numbers[0]
        self._numbers.append(number)
        self._sum += number
        self._since_exact += 1
        # What rounding leaves in the sum goes before it can grow.
        if self._since_exact >= self._window:
            self._sum, self._since_exact = math.fsum(self._numbers), 0

    def clear(self) -> None:
        """Forget all numbers."""
        self._numbers.clear()
        self._sum, self._since_exact = 0.0, 0

    @property
    def mean(self) -> float:
        """The mean; infinite of nothing."""
        return self._sum / len(self._numbers) if self._numbers else math.inf

    def mean_of_last(self, count: int) -> float:
        """Return the mean of the last so many, or of all where there are fewer; infinite of nothing."""
        last = list(islice(reversed(self._numbers), count))
        return math.fsum(last) / len(last) if last else math.inf
