"""Keeping a moving target in the middle of the image and at the working distance, with a scope that pivots at its trocar."""

import math
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from laploop.control.controllers.tip_motion import steady_gain
from laploop.control.messages import ControlInput
from laploop.control.prediction.motion_predictor import MotionPredictor
from laploop.control.targeting.targeting import Target, Targeting, TargetingConfig
from laploop.control.vectors import length
from laploop.errors import InvalidValueError
from laploop.perception.geometry import Rig

Array = NDArray[np.float64]


class LookPhase(StrEnum):
    """What the controller is doing."""

    WAIT = "wait"
    """No frame has shown the target yet: the camera stands still."""
    CENTRE = "centre"
    """The camera moves so that the target comes to the middle, at the working distance, and stays there."""
    LOST = "lost"
    """The target has not been seen for too long: the camera stands still, so that it may come back into view."""


@dataclass(frozen=True, kw_only=True)
class LookControllerConfig:
    """Gains and bounds of `LookController`."""

    targeting: TargetingConfig = field(default_factory=lambda: TargetingConfig(prediction="rhythms", follow_camera=True))
    gain_per_s: float = 4.0
    """Speed per error of the target's place in the camera's frame."""
    max_speed_mps: float = 0.05
    """Of the scope's tip."""
    least_room_m: float = 0.045
    """The camera does not come nearer than this to any tissue that it has seen."""
    max_age_s: float = 0.5

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a number is not finite and above 0, or targeting does not follow the camera.
        """
        for name in ("gain_per_s", "max_speed_mps", "least_room_m", "max_age_s"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise InvalidValueError(name, getattr(self, name), "finite and above 0")
        if not self.targeting.follow_camera:
            raise InvalidValueError("targeting", self.targeting, "one with follow_camera=True: the camera moves")


class LookController:
    """A `TipController` of the scope's tip: position-based visual servoing through the trocar.

    A scope of which L is inserted pivots at its trocar. Its tip, at (b/2, 0, 0) of the camera's frame, moves by v; then the
    shaft turns by omega = (-v_y, v_x, 0) / L, and a point at rest at (x, y, z) moves in the camera's frame by

        dx = -(1 + z/L) v_x,   dy = -(1 + z/L) v_y,   dz = (x - b/2)/L v_x + y/L v_y - v_z,

    which is solved for v in closed form. The roll about the shaft is left to the arm.
    """

    def __init__(self, rig: Rig, config: LookControllerConfig | None = None, predictor: MotionPredictor | None = None) -> None:
        """Take the camera's geometry, and a predictor to use in place of the one that the config names."""
        self._config = config = config or LookControllerConfig()
        self._targeting = Targeting(rig, config.targeting, predictor)
        self._half_baseline = 0.5 * rig.baseline_m
        self.reset()

    @property
    def phase(self) -> LookPhase:
        """What the controller is doing."""
        return self._phase

    @property
    def target(self) -> Target | None:
        """What is known of the target, from the last tick."""
        return self._target

    def reset(self) -> None:
        """Forget everything; a new episode begins."""
        self._targeting.reset()
        self._target: Target | None = None
        self._phase = LookPhase.WAIT

    def command(self, state: ControlInput) -> Array:
        """Return the desired velocity (3,) of the scope's tip in m/s in the camera's frame.

        Raises:
            InvalidValueError: If the camera's pose or the scope's trocar is missing.
        """
        if state.scope_trocar_in_camera is None:
            raise InvalidValueError("scope_trocar_in_camera", None, "where the scope's shaft passes the wall, (3,)")
        self._target = target = self._targeting.update(state)
        if target is None:
            return np.zeros(3)
        lost = target.age_ns(state.now_ns) * 1e-9 > self._config.max_age_s
        self._phase = LookPhase.LOST if lost else LookPhase.CENTRE
        if lost:
            return np.zeros(3)
        inserted = length(state.scope_trocar_in_camera - [self._half_baseline, 0.0, 0.0])
        gain = steady_gain(self._config.gain_per_s, state.lead_ns)
        wanted = gain * (np.array([0.0, 0.0, state.working_distance_m]) - target.point)
        velocity = self._tip_velocity(wanted - target.velocity, target.point, inserted)
        if target.nearest_depth < self._config.least_room_m:
            velocity[2] = min(velocity[2], 0.0)
        speed = length(velocity)
        return velocity * min(1.0, self._config.max_speed_mps / max(speed, 1e-12))

    def _tip_velocity(self, point_rate: Array, point: Array, inserted: float) -> Array:
        """Return the velocity (3,) of the tip that moves a resting point at that rate in the camera's frame."""
        across = -point_rate[:2] / (1.0 + point[2] / inserted)
        lever = np.array([point[0] - self._half_baseline, point[1]]) / inserted
        return np.array([across[0], across[1], float(lever @ across) - point_rate[2]])
