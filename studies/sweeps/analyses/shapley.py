"""Shapley values: what each of several causes costs when they act together (Shapley 1953)."""

import math
from collections.abc import Callable, Sequence
from itertools import combinations


def shapley_values(causes: Sequence[str], cost: Callable[[frozenset[str]], float]) -> dict[str, float]:
    """Share the cost of all causes, less that of none, between them.

    A cause's part is what it adds to those that act before it, averaged over all orders in which they could come. The parts add
    up to the whole exactly, a cause that never adds anything has none, and causes that always add the same have the same.

    Args:
        causes: Their names.
        cost: Of the causes that act, for every set of them.
    """
    count, found = len(causes), {}
    for cause in causes:
        others = [one for one in causes if one != cause]
        part = 0.0
        for size in range(count):
            weight = math.factorial(size) * math.factorial(count - size - 1) / math.factorial(count)
            for before in map(frozenset, combinations(others, size)):
                part += weight * (cost(before | {cause}) - cost(before))
        found[cause] = part
    return found
