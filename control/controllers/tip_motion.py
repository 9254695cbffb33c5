"""Speeds of the tip on its ways: far from tissue, near it, and the legs that lead from the start to a stand-off."""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from laploop.control.controllers.approach_geometry import ApproachGeometry
from laploop.control.vectors import length
from laploop.errors import InvalidValueError

Array = NDArray[np.float64]

_STEADY = 0.4
"""Gain times delay that a late loop may have."""

_STIFFEST_N_PER_M = 300.0
"""Under a small ball; the phantom has 100 to 300. Softer tissue answers more slowly, never with ringing."""


class Leg(StrEnum):
    """Parts of the way to a stand-off."""

    RISE = "rise"
    """Out along the shaft until the tip is above all tissue in view."""
    TRAVEL = "travel"
    """Towards a point above the target from which the shaft's own direction leads to the stand-off."""
    DESCEND = "descend"
    """To the stand-off."""
    ARRIVED = "arrived"
    """At the stand-off, with the target in sight."""


@dataclass(frozen=True, kw_only=True)
class TipMotion:
    """How fast the tip goes where."""

    max_speed_mps: float = 0.06
    max_catch_up_mps: float = 0.020
    """Fastest return to a reference near tissue, relative to it."""
    acceleration_mps2: float = 0.4
    """With which travelling ends at a way-point."""
    position_gain_per_s: float = 8.0
    """Speed per distance from the reference."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a number is not finite and above 0.
        """
        for name, value in vars(self).items():
            if not 0.0 < value < math.inf:
                raise InvalidValueError(name, value, "finite and above 0")

    def gain(self, lead_ns: int) -> float:
        """Return the position gain per second that stays well damped when the arm answers that late."""
        return steady_gain(self.position_gain_per_s, lead_ns)

    def towards(self, way: Array, *, lead_ns: int = 0) -> Array:
        """Return the velocity (3,) that ends a way (3,) at rest."""
        distance = max(length(way), 1e-12)
        speed = min(self.max_speed_mps, math.sqrt(2.0 * self.acceleration_mps2 * distance), self.gain(lead_ns) * distance)
        return way * (speed / distance)

    def back(self, way: Array, *, lead_ns: int = 0) -> Array:
        """Return the velocity (3,) that removes a lag (3,); near tissue that must never be a leap."""
        velocity = self.gain(lead_ns) * way
        return velocity * min(1.0, self.max_catch_up_mps / max(length(velocity), 1e-12))

    def bounded(self, velocity: Array) -> Array:
        """Cut a velocity (3,) to the highest speed."""
        speed = length(velocity)
        return velocity * min(1.0, self.max_speed_mps / max(speed, 1e-12))

    def leg_after(self, leg: Leg, tip: Array, geometry: ApproachGeometry, *, in_sight: bool) -> Leg:
        """Return the leg to be on now; several may be over at once."""
        if leg is Leg.RISE and tip[2] < geometry.safe_depth + 0.002:
            leg = Leg.TRAVEL
        if leg is Leg.TRAVEL and length(geometry.above - tip) < 0.003:
            leg = Leg.DESCEND
        if leg is Leg.DESCEND and in_sight and length(geometry.standoff - tip) < 0.002:
            leg = Leg.ARRIVED
        return leg

    def along(self, leg: Leg, tip: Array, geometry: ApproachGeometry) -> Array:
        """Return the velocity (3,) on a leg; at the stand-off it is that of the surface."""
        match leg:
            case Leg.RISE:
                return 0.5 * self.max_speed_mps * geometry.shaft
            case Leg.TRAVEL:
                return geometry.flow + self.towards(geometry.above - tip, lead_ns=geometry.lead_ns)
            case _:
                return geometry.flow + self.towards(geometry.standoff - tip, lead_ns=geometry.lead_ns)


def steady_admittance(admittance_mps_per_n: float, lead_ns: int) -> float:
    """Cut the speed per newton likewise, for the stiffest tissue that a touch should not ring on."""
    return min(admittance_mps_per_n, steady_gain(math.inf, lead_ns) / _STIFFEST_N_PER_M)


def steady_gain(gain_per_s: float, lead_ns: int) -> float:
    """Cut the gain of a loop whose plant integrates and answers late.

    Such a loop rings from pi/2 divided by the delay on and decays without overshoot up to 1/e of it; 0.4 lies beside that.
    """
    return gain_per_s if lead_ns <= 0 else min(gain_per_s, _STEADY / (lead_ns * 1e-9))
