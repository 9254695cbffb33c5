"""Hovering close over a point of tissue that moves."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from laploop.control.controllers.safe_approach import SafeApproach, SafeApproachConfig
from laploop.control.messages import ControlInput
from laploop.control.prediction.motion_predictor import MotionPredictor
from laploop.control.targeting.targeting import Target, Targeting, TargetingConfig
from laploop.errors import InvalidValueError
from laploop.perception.geometry import Rig

Array = NDArray[np.float64]

HOLD = "hold"
"""Phase of a controller that is at its work."""


@dataclass(frozen=True, kw_only=True)
class TrackControllerConfig:
    """What `TrackController` holds, and how it gets there."""

    targeting: TargetingConfig = field(default_factory=lambda: TargetingConfig(prediction="rhythms"))
    approach: SafeApproachConfig = field(default_factory=SafeApproachConfig)
    standoff_m: float = 0.003
    """Between the surface and the ball end, along the normal."""
    approach_speed_mps: float = 0.010
    """Along the normal, relative to the tissue."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a number is not finite and above 0, or the stand-off lies beyond the approach's.
        """
        for name in ("standoff_m", "approach_speed_mps"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise InvalidValueError(name, getattr(self, name), "finite and above 0")
        farthest = self.approach.distances.standoff_m
        if self.standoff_m > farthest:
            raise InvalidValueError("standoff_m", self.standoff_m, f"at most the approach's, {farthest}")


class TrackController:
    """A `TipController` that holds a stand-off over the target along its normal.

    Once at the stand-off it commands the target's predicted velocity at the time when the command takes effect, and removes
    what is left of the error by a bounded proportional term. Nothing should be touched: a bump makes it withdraw.
    """

    def __init__(self, rig: Rig, config: TrackControllerConfig | None = None, predictor: MotionPredictor | None = None) -> None:
        """Take the camera's geometry, and a predictor to use in place of the one that the config names."""
        self._config = config = config or TrackControllerConfig()
        self._targeting = Targeting(rig, config.targeting, predictor)
        self._approach = SafeApproach(config.approach)
        self.reset()

    @property
    def phase(self) -> str:
        """What the controller is doing: a phase of the approach, or `hold`."""
        return HOLD if self._holding else self._approach.phase.value

    @property
    def target(self) -> Target | None:
        """What is known of the target, from the last tick."""
        return self._target

    def reset(self) -> None:
        """Forget everything; a new episode begins."""
        self._targeting.reset()
        self._approach.reset()
        self._target: Target | None = None
        self._holding = False
        self._height = 0.0
        self._last_ns: int | None = None

    def command(self, state: ControlInput) -> Array:
        """Return the desired tip velocity (3,) in m/s in the camera's frame."""
        elapsed = 0.0 if self._last_ns is None else (state.now_ns - self._last_ns) * 1e-9
        self._last_ns = state.now_ns
        self._target = self._targeting.update(state)
        velocity = self._approach.advance(state, self._target)
        geometry = self._approach.geometry
        if velocity is not None or geometry is None:
            self._holding = False
            return np.zeros(3) if velocity is None else velocity
        motion, config = self._config.approach.motion, self._config
        if not self._holding:
            self._holding = True
            self._height = max(float((state.tip_in_camera - geometry.goal) @ geometry.normal), config.standoff_m)
        sink = min(config.approach_speed_mps * elapsed, self._height - config.standoff_m)
        self._height -= sink
        feed_forward = geometry.flow
        if elapsed > 0.0:
            feed_forward = feed_forward - sink / elapsed * geometry.normal
        way = geometry.goal + self._height * geometry.normal - state.tip_in_camera
        return motion.bounded(feed_forward + motion.back(way, lead_ns=state.lead_ns))
