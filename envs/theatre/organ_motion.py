"""How the organ below the phantom moves: respiration and heartbeat along the stage's axis, and a slow sideways travel."""

import math
from dataclasses import replace
from typing import Annotated, Literal, get_args

import numpy as np

from laploop.arrays import Array
from laploop.configuration import Field, configuration
from laploop.errors import UnknownNameError

MotionName = Literal["still", "breathing", "beating", "both"]
"""The named motions, in the order in which they are listed to users."""

PeakToPeak = Annotated[float, Field(ge=0.0, le=0.03)]
Frequency = Annotated[float, Field(gt=0.0, le=5.0)]
Phase = Annotated[float, Field(ge=-1000.0, le=1000.0)]


@configuration
class BaseMotion:
    """Sum of two sines along the stage's axis, in steady motion from the start; positive is towards the scope.

    `z(t) = A_b/2 sin(2 pi f_b t + phi_b) + A_h/2 sin(2 pi f_h t + phi_h)` with peak-to-peak amplitudes A. Organs of ventilated
    patients move 5-12 mm at 0.2-0.35 Hz; bowel beats with at most 1 mm at 1-1.5 Hz.
    """

    breathing_peak_to_peak_m: PeakToPeak = 0.0
    """Stroke of respiration."""
    breathing_hz: Frequency = 0.25
    """Frequency of respiration."""
    breathing_phase_rad: Phase | None = None
    """Phase at time 0; by default the theatre's seed draws it."""
    beating_peak_to_peak_m: PeakToPeak = 0.0
    """Stroke of the heartbeat."""
    beating_hz: Frequency = 1.2
    """Frequency of the heartbeat."""
    beating_phase_rad: Phase | None = None
    """Phase at time 0; by default the theatre's seed draws it."""

    @classmethod
    def named(cls, name: str) -> "BaseMotion":
        """Make one of the named motions: still, breathing (10 mm at 0.25 Hz), beating (1 mm at 1.2 Hz), or both.

        Raises:
            UnknownNameError: If there is no motion of this name.
        """
        if name not in get_args(MotionName):
            raise UnknownNameError("motion", name, get_args(MotionName))
        return cls(
            breathing_peak_to_peak_m=0.010 if name in {"breathing", "both"} else 0.0,
            beating_peak_to_peak_m=0.001 if name in {"beating", "both"} else 0.0,
        )

    def with_phases(self, rng: np.random.Generator) -> "BaseMotion":
        """Return the motion with each phase that is None drawn; always makes two draws."""
        breathing, beating = rng.uniform(0.0, 2.0 * math.pi, size=2)
        return replace(
            self,
            breathing_phase_rad=float(breathing) if self.breathing_phase_rad is None else self.breathing_phase_rad,
            beating_phase_rad=float(beating) if self.beating_phase_rad is None else self.beating_phase_rad,
        )

    def displacement(self, time_s: float) -> float:
        """Return z(t) in metres; phases that are None count as 0."""
        waves = (
            (self.breathing_peak_to_peak_m, self.breathing_hz, self.breathing_phase_rad or 0.0),
            (self.beating_peak_to_peak_m, self.beating_hz, self.beating_phase_rad or 0.0),
        )
        return 0.5 * sum(amplitude * math.sin(2.0 * math.pi * hertz * time_s + phase) for amplitude, hertz, phase in waves)


@configuration
class StageTravel:
    """Two sines along the world's x and y that start from the middle, as when an organ is retracted; off by default."""

    x_peak_to_peak_m: Annotated[float, Field(ge=0.0, le=0.05)] = 0.0
    """Stroke along the world\'s x."""
    x_hz: Annotated[float, Field(ge=0.001, le=0.5)] = 0.08
    """Frequency along the world\'s x."""
    y_peak_to_peak_m: Annotated[float, Field(ge=0.0, le=0.05)] = 0.0
    """Stroke along the world\'s y."""
    y_hz: Annotated[float, Field(ge=0.001, le=0.5)] = 0.05
    """Frequency along the world\'s y."""

    def displacement(self, time_s: float) -> Array:
        """Return the stage's offset from its middle at a time, (2,), metres along the world's x and y."""
        x = 0.5 * self.x_peak_to_peak_m * math.sin(2.0 * math.pi * self.x_hz * time_s)
        y = 0.5 * self.y_peak_to_peak_m * math.sin(2.0 * math.pi * self.y_hz * time_s)
        return np.array([x, y])
