"""Named reward terms of the reach task."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class ReachRewardWeights:
    """What each term counts; a term's value times its weight is what `info["reward_terms"]` shows."""

    distance: float = 1.0
    progress: float = 20.0
    contact: float = 0.1
    force: float = 0.5
    effort: float = 0.02
    success: float = 10.0
    harm: float = 10.0


def reach_reward_terms(
    *,
    error_mm: float,
    previous_error_mm: float,
    contact_force_n: float,
    alarm_force_n: float,
    action_fraction: float,
    succeeded: bool,
    harmed: bool,
) -> dict[str, float]:
    """Return the unweighted terms of one control period.

    Args:
        error_mm: Distance of the tip from an ideal touch of the target.
        previous_error_mm: The same a period before.
        contact_force_n: Magnitude of the force on the tip.
        alarm_force_n: Force from which pressing is punished.
        action_fraction: Commanded speed over the largest allowed one.
        succeeded: Whether the task has just been solved.
        harmed: Whether a safety limit has just been passed.
    """
    return {
        "distance": -float(np.tanh(error_mm / 20.0)),
        "progress": (previous_error_mm - error_mm) / 20.0,
        "contact": float(contact_force_n > 0.0 and error_mm < 1.5),
        "force": -max(0.0, contact_force_n - alarm_force_n),
        "effort": -(action_fraction**2),
        "success": float(succeeded),
        "harm": -float(harmed),
    }
