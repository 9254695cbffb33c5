"""A slow sideways travel of the stage, besides the motion of organs along its axis."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from laploop.errors import check_range

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class StageTravel:
    """Two sines along the world's x and y that start from the middle, as of an organ that is pulled; off by default."""

    x_peak_to_peak_m: float = 0.0
    x_hz: float = 0.08
    y_peak_to_peak_m: float = 0.0
    y_hz: float = 0.05

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a field lies outside its range.
        """
        for name in ("x_peak_to_peak_m", "y_peak_to_peak_m"):
            check_range(name, getattr(self, name), 0.0, 0.05)
        for name in ("x_hz", "y_hz"):
            check_range(name, getattr(self, name), 0.001, 0.5)

    def displacement(self, time_s: float) -> Array:
        """Return how far the stage is from its middle, (2,), metres along the world's x and y."""
        return np.array(
            [
                0.5 * self.x_peak_to_peak_m * math.sin(2.0 * math.pi * self.x_hz * time_s),
                0.5 * self.y_peak_to_peak_m * math.sin(2.0 * math.pi * self.y_hz * time_s),
            ]
        )
