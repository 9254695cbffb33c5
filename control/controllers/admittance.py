"""Force control by speed: how fast the tip lifts or presses for a force that is not the one wanted."""

import math
from typing import Annotated

from laploop.configuration import Field, configuration
from laploop.control.controllers.tip_motion import steady_gain

_MAX_STIFFNESS_N_PER_M = 300.0
"""Under a small ball; the phantom has 100 to 300. Softer tissue answers more slowly, never with ringing."""
_MAX_INTEGRAL_FRACTION = 0.4
"""Of the loop's own rate: the rate of the integral at which the loop is damped by 0.8; from 0.25 down it does not overshoot."""


@configuration
class AdmittanceConfig:
    """Speed along the surface's normal per newton of too much or too little force."""

    gain_mps_per_n: Annotated[float, Field(gt=0.0, le=1.0)]
    """Speed per newton."""
    integral_per_s: Annotated[float, Field(ge=0.0, le=100.0)] = 0.0
    """Rate at which a lasting deviation raises the speed: it removes what prediction misses of the tissue's own speed."""
    max_press_speed_mps: Annotated[float, Field(gt=0.0, le=0.1)] = 0.006
    """Greatest speed towards the tissue."""
    max_yield_speed_mps: Annotated[float, Field(gt=0.0, le=0.5)] = 0.030
    """Greatest speed away from the tissue."""


class Admittance:
    """Proportional and integral control of a force by speed, damped for an arm that answers late."""

    def __init__(self, config: AdmittanceConfig) -> None:
        """Start without memory."""
        self._config = config
        self.reset()

    def reset(self) -> None:
        """Forget lasting deviations."""
        self._lasting_mps = 0.0

    def lift_mps(self, excess_n: float, lead_ns: int, elapsed_s: float) -> float:
        """Return the speed along the outward normal.

        Args:
            excess_n: Force felt minus force wanted.
            lead_ns: How late the arm answers.
            elapsed_s: Time since the last call.
        """
        config = self._config
        gain = min(config.gain_mps_per_n, steady_gain(math.inf, lead_ns) / _MAX_STIFFNESS_N_PER_M)
        rate = min(config.integral_per_s, _MAX_INTEGRAL_FRACTION * gain * _MAX_STIFFNESS_N_PER_M)
        # Within the speeds' own bounds, so that it cannot wind up.
        self._lasting_mps = self._bounded(self._lasting_mps + rate * elapsed_s * gain * excess_n)
        return self._bounded(gain * excess_n + self._lasting_mps)

    def _bounded(self, speed_mps: float) -> float:
        return min(max(speed_mps, -self._config.max_press_speed_mps), self._config.max_yield_speed_mps)
