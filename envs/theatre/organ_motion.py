"""How the organ below the phantom moves: respiration and heartbeat along the stage's axis."""

import math
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from laploop.errors import InvalidValueError, UnknownNameError

MotionName = Literal["still", "breathing", "beating", "both"]
"""The named motions, in the order in which they are listed to users."""


@dataclass(frozen=True, kw_only=True)
class BaseMotion:
    """Sum of two sines along the stage's axis, in steady motion from the start; positive is towards the scope.

    `z(t) = A_b/2 sin(2 pi f_b t + phi_b) + A_h/2 sin(2 pi f_h t + phi_h)` with peak-to-peak amplitudes A. Organs of ventilated
    patients move 5-12 mm at 0.2-0.35 Hz; bowel beats with at most 1 mm at 1-1.5 Hz.
    """

    breathing_peak_to_peak_m: float = 0.0
    breathing_hz: float = 0.25
    breathing_phase_rad: float | None = None
    """Phase at time 0; None lets the theatre's seed choose."""
    beating_peak_to_peak_m: float = 0.0
    beating_hz: float = 1.2
    beating_phase_rad: float | None = None
    """Phase at time 0; None lets the theatre's seed choose."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a field lies outside its range.
        """
        for name in ("breathing_peak_to_peak_m", "beating_peak_to_peak_m"):
            if not 0.0 <= getattr(self, name) <= 0.03:
                raise InvalidValueError(name, getattr(self, name), "0 to 0.03 m")
        for name in ("breathing_hz", "beating_hz"):
            if not 0.0 < getattr(self, name) <= 5.0:
                raise InvalidValueError(name, getattr(self, name), "above 0, up to 5 Hz")
        for name in ("breathing_phase_rad", "beating_phase_rad"):
            phase = getattr(self, name)
            if phase is not None and not math.isfinite(phase):
                raise InvalidValueError(name, phase, "a finite angle, or None")

    @classmethod
    def named(cls, name: str) -> "BaseMotion":
        """Make one of the named motions: still, breathing (10 mm at 0.25 Hz), beating (1 mm at 1.2 Hz), or both.

        Raises:
            UnknownNameError: If nobody knows the name.
        """
        if name not in get_args(MotionName):
            raise UnknownNameError("motion", name, get_args(MotionName))
        return cls(
            breathing_peak_to_peak_m=0.010 if name in {"breathing", "both"} else 0.0,
            beating_peak_to_peak_m=0.001 if name in {"beating", "both"} else 0.0,
        )

    def with_phases(self, rng: np.random.Generator) -> "BaseMotion":
        """Return the same motion with every open phase drawn; two draws are made whatever is open."""
        breathing, beating = rng.uniform(0.0, 2.0 * math.pi, size=2)
        return replace(
            self,
            breathing_phase_rad=float(breathing) if self.breathing_phase_rad is None else self.breathing_phase_rad,
            beating_phase_rad=float(beating) if self.beating_phase_rad is None else self.beating_phase_rad,
        )

    def displacement(self, time_s: float) -> float:
        """Return z(t) in metres; open phases count as 0."""
        return 0.5 * sum(
            amplitude * math.sin(2.0 * math.pi * hertz * time_s + phase) for amplitude, hertz, phase in self._waves()
        )

    def velocity(self, time_s: float) -> float:
        """Return dz/dt in m/s."""
        return 0.5 * sum(
            amplitude * 2.0 * math.pi * hertz * math.cos(2.0 * math.pi * hertz * time_s + phase)
            for amplitude, hertz, phase in self._waves()
        )

    def _waves(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        return (
            (self.breathing_peak_to_peak_m, self.breathing_hz, self.breathing_phase_rad or 0.0),
            (self.beating_peak_to_peak_m, self.beating_hz, self.beating_phase_rad or 0.0),
        )
