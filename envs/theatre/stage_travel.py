"""A slow sideways travel of the stage, besides the motion of organs along its axis."""

import math
from typing import Annotated

import numpy as np

from laploop.arrays import Array
from laploop.configuration import Field, configuration

PeakToPeak = Annotated[float, Field(ge=0.0, le=0.05)]
Frequency = Annotated[float, Field(ge=0.001, le=0.5)]


@configuration
class StageTravel:
    """Two sines along the world's x and y that start from the middle, as when an organ is retracted; off by default."""

    x_peak_to_peak_m: PeakToPeak = 0.0
    x_hz: Frequency = 0.08
    y_peak_to_peak_m: PeakToPeak = 0.0
    y_hz: Frequency = 0.05

    def displacement(self, time_s: float) -> Array:
        """Return the stage's offset from its middle at a time, (2,), metres along the world's x and y."""
        return np.array(
            [
                0.5 * self.x_peak_to_peak_m * math.sin(2.0 * math.pi * self.x_hz * time_s),
                0.5 * self.y_peak_to_peak_m * math.sin(2.0 * math.pi * self.y_hz * time_s),
            ]
        )
