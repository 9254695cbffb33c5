"""Rewards as sums of named terms."""

from typing import Any


def weighted(terms: dict[str, float], weights: Any) -> dict[str, float]:
    """Multiply each term by the weight that is a field of the same name; the result goes to `info["reward_terms"]`."""
    return {name: value * float(getattr(weights, name)) for name, value in terms.items()}
