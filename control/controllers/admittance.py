"""Force control by speed: how fast the tip lifts or presses for a force that is not the one wanted."""

import math
from typing import Annotated

from laploop.configuration import Field, configuration
from laploop.control.controllers.tip_motion import steady_gain

_MAX_STIFFNESS_N_PER_M = 300.0
"""Under a small ball; the phantom has 100 to 300. Softer tissue answers more slowly, never with ringing."""


@configuration
class Admittance:
    """Speed along the surface's normal per newton of too much or too little force."""

    gain_mps_per_n: Annotated[float, Field(gt=0.0, le=1.0)]
    """Speed per newton."""
    max_press_speed_mps: Annotated[float, Field(gt=0.0, le=0.1)] = 0.006
    """Greatest speed towards the tissue."""
    max_yield_speed_mps: Annotated[float, Field(gt=0.0, le=0.5)] = 0.030
    """Greatest speed away from the tissue."""

    def lift_mps(self, excess_n: float, lead_ns: int) -> float:
        """Return the speed along the outward normal for an excess of force, damped for an arm that answers late."""
        gain = min(self.gain_mps_per_n, steady_gain(math.inf, lead_ns) / _MAX_STIFFNESS_N_PER_M)
        return min(max(gain * excess_n, -self.max_press_speed_mps), self.max_yield_speed_mps)
