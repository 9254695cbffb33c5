"""Rewards as sums of named terms."""

from typing import Any

import numpy as np


def weighted(terms: dict[str, float], weights: Any) -> dict[str, float]:
    """Multiply each term by the weight that is a field of the same name; the result goes to `info["reward_terms"]`."""
    return {name: value * float(getattr(weights, name)) for name, value in terms.items()}


def nearness(error: float, scale: float) -> float:
    """Return a term that falls from 0 without an error to -1 far away: minus tanh of the error over a scale."""
    return -float(np.tanh(error / scale))
