"""What rewards are made of.

A step's terms are of the order of one over the length of an episode, so that returns are of order one. All functions take
numbers, or arrays with an entry an environment.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

SUCCESS = 1.0
"""Reward for solving the task."""
HARM = 1.0
"""Punishment for passing a safety limit; more than an episode costs that is waited out."""
TIME = 0.5
"""Cost of an episode that lasts to its end without a success."""
FORCE = 2.0
"""Cost of an episode of pressing as hard as is allowed; nothing up to the alarm, and linear between."""
SPEED = 0.1
"""Cost of an episode of largest actions; quadratic."""

_APPROACH_MM = 50.0
"""About the distance at which episodes begin, 20 to 80 mm."""
_ARRIVAL_MM = 5.0
"""Where the last stretch begins, on which a millimetre counts more."""


def approach(error_mm: Any) -> Any:
    """Return the potential of a distance from the goal: minus distance over 50 mm, minus half the tanh of it over 5 mm.

    What a learner is rewarded with is its difference over a step: over an episode it adds up to that of begin and end, whatever
    the way between.
    """
    return -error_mm / _APPROACH_MM - 0.5 * np.tanh(error_mm / _ARRIVAL_MM)


def closeness(error: Any, scale: float) -> Any:
    """Return 1 without an error, 1/e at the scale, 0 far away."""
    return np.exp(-np.abs(error) / scale)


def shared_terms(quantities: Mapping[str, Any], *, alarm_n: float, harm_n: float, fraction: float) -> dict[str, Any]:
    """Return the terms of all tasks.

    Args:
        quantities: `force_n`, the worst on the tip; `action`, (..., n), -1 to 1; `succeeded` and `harmed`, 0 or 1.
        alarm_n: Force up to which pressing costs nothing.
        harm_n: Force that ends the episode.
        fraction: Of an episode, that the step takes.
    """
    force = np.clip((quantities["force_n"] - alarm_n) / max(harm_n - alarm_n, 1e-3), 0.0, 1.0)
    return {
        "force": -FORCE * fraction * force,
        "speed": -SPEED * fraction * np.mean(np.square(quantities["action"]), axis=-1),
        "success": SUCCESS * quantities["succeeded"],
        "harm": -HARM * quantities["harmed"],
    }
