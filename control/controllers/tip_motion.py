"""Speeds of the tip on its ways: far from tissue, near it, and the legs that lead from the start to a stand-off."""

import math
from typing import Annotated

import numpy as np

from laploop.arrays import Array
from laploop.configuration import Field, configuration
from laploop.control.controllers.approach_geometry import ApproachGeometry
from laploop.control.controllers.phase import Phase

_MAX_GAIN_DELAY = 0.4
"""Greatest product of gain and delay."""


@configuration
class TipMotion:
    """How fast the tip goes where."""

    max_speed_mps: Annotated[float, Field(gt=0.0, le=1.0)] = 0.06
    """Greatest speed of the tip."""
    max_catch_up_mps: Annotated[float, Field(gt=0.0, le=1.0)] = 0.020
    """Fastest return to a reference near tissue, relative to it."""
    acceleration_mps2: Annotated[float, Field(gt=0.0, le=10.0)] = 0.4
    """Deceleration with which travelling ends at a way-point."""
    position_gain_per_s: Annotated[float, Field(gt=0.0, le=100.0)] = 8.0
    """Speed per distance from the reference."""

    def gain(self, lead_ns: int) -> float:
        """Return the position gain per second that stays well damped when the arm answers that late."""
        return steady_gain(self.position_gain_per_s, lead_ns)

    def towards(self, way: Array, *, lead_ns: int = 0) -> Array:
        """Return the velocity (3,) that ends a way (3,) at rest."""
        distance = max(float(np.linalg.norm(way)), 1e-12)
        speed = min(self.max_speed_mps, math.sqrt(2.0 * self.acceleration_mps2 * distance), self.gain(lead_ns) * distance)
        return way * (speed / distance)

    def back(self, way: Array, *, lead_ns: int = 0) -> Array:
        """Return the velocity (3,) that removes a lag (3,); near tissue that must never be a leap."""
        return limited(self.gain(lead_ns) * way, self.max_catch_up_mps)

    def bounded(self, velocity: Array) -> Array:
        """Cut a velocity (3,) to the highest speed."""
        return limited(velocity, self.max_speed_mps)

    def leg_after(self, leg: Phase, tip: Array, geometry: ApproachGeometry) -> Phase:
        """Return the leg to be on now, `READY` at the stand-off; several may be over at once."""
        if leg is Phase.RISE and tip[2] < geometry.safe_depth + 0.002:
            leg = Phase.TRAVEL
        if leg is Phase.TRAVEL and np.linalg.norm(geometry.above - tip) < 0.003:
            leg = Phase.DESCEND
        if leg is Phase.DESCEND and np.linalg.norm(geometry.standoff - tip) < 0.002:
            leg = Phase.READY
        return leg

    def along(self, leg: Phase, tip: Array, geometry: ApproachGeometry) -> Array:
        """Return the velocity (3,) on a leg; at the stand-off it is that of the surface."""
        if leg is Phase.RISE:
            return 0.5 * self.max_speed_mps * geometry.shaft
        end = geometry.above if leg is Phase.TRAVEL else geometry.standoff
        return geometry.flow + self.towards(end - tip, lead_ns=geometry.lead_ns)


def limited(velocity: Array, max_speed: float) -> Array:
    """Return a velocity (3,) cut to a speed."""
    return velocity * min(1.0, max_speed / max(float(np.linalg.norm(velocity)), 1e-12))


def steady_gain(gain_per_s: float, lead_ns: int) -> float:
    """Cut the gain of a loop whose plant integrates and answers late.

    Such a loop rings from pi/2 divided by the delay on and decays without overshoot up to 1/e of it; 0.4 lies beside that.
    """
    return gain_per_s if lead_ns <= 0 else min(gain_per_s, _MAX_GAIN_DELAY / (lead_ns * 1e-9))
