"""Keeping a moving target in the middle of the image and at the working distance, with a scope that pivots at its trocar."""

from typing import Annotated

import numpy as np

from laploop.arrays import Array
from laploop.configuration import Field, configuration
from laploop.control.controllers.base import TaskController, TaskControllerConfig
from laploop.control.controllers.phase import Phase
from laploop.control.controllers.scope_motion import scope_tip_velocity
from laploop.control.controllers.tip_motion import limited, steady_gain
from laploop.control.messages import ControlInput
from laploop.control.targeting.targeting import TargetingConfig
from laploop.errors import InvalidValueError


@configuration
class LookControllerConfig(TaskControllerConfig):
    """Gains and bounds of `LookController`."""

    targeting: TargetingConfig = Field(default_factory=lambda: TargetingConfig(prediction="rhythms", follow_camera=True))
    """How the target is followed."""
    gain_per_s: Annotated[float, Field(gt=0.0, le=100.0)] = 4.0
    """Speed per error of the target's place in the camera's frame."""
    max_speed_mps: Annotated[float, Field(gt=0.0, le=1.0)] = 0.05
    """Greatest speed of the scope's tip."""
    min_clearance_m: Annotated[float, Field(gt=0.0, le=1.0)] = 0.045
    """Distance below which the camera does not come nearer to any tissue that it has seen."""
    max_age_s: Annotated[float, Field(gt=0.0, le=10.0)] = 0.5
    """Time since the target was seen after which the camera stands still."""

    def __post_init__(self) -> None:
        if not self.targeting.follow_camera:
            raise InvalidValueError("targeting.follow_camera", self.targeting.follow_camera, "true: the camera moves")


class LookController(TaskController[LookControllerConfig]):
    """A `TipController` of the scope's tip: position-based visual servoing through the trocar."""

    config_class = LookControllerConfig

    @property
    def phase(self) -> Phase:
        """What the controller is doing."""
        return self._phase

    def reset(self) -> None:
        """Forget everything; a new episode begins."""
        super().reset()
        self._phase = Phase.WAIT

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
        self._phase = Phase.LOST if lost else Phase.CENTRE
        if lost:
            return np.zeros(3)
        lever = np.array([0.5 * self._rig.baseline_m, 0.0, 0.0])
        inserted = float(np.linalg.norm(state.scope_trocar_in_camera - lever))
        gain = steady_gain(self._config.gain_per_s, state.lead_ns)
        wanted = gain * (np.array([0.0, 0.0, state.working_distance_m]) - target.point)
        velocity = scope_tip_velocity(wanted - target.velocity, target.point - lever, inserted)
        if target.nearest_depth < self._config.min_clearance_m:
            velocity[2] = min(velocity[2], 0.0)
        return limited(velocity, self._config.max_speed_mps)
