"""The last millimetres: down until something is felt, and what that says about where the surface really is."""

from typing import Annotated

import numpy as np

from laploop.arrays import Array
from laploop.configuration import Field, configuration
from laploop.control.controllers.approach_geometry import ApproachGeometry
from laploop.control.controllers.tip_motion import TipMotion
from laploop.control.messages import ControlInput


@configuration
class GuardedMoveConfig:
    """How contact is looked for, and what a felt surface corrects."""

    approach_speed_mps: Annotated[float, Field(gt=0.0, le=0.2)] = 0.010
    """Speed relative to the tissue, from the stand-off on."""
    early_contact_m: Annotated[float, Field(gt=0.0, le=0.1)] = 0.005
    """Distance before the estimated surface beyond which a touch is one of an obstacle, not the target."""
    search_m: Annotated[float, Field(gt=0.0, le=0.1)] = 0.003
    """Distance beyond the estimated surface over which contact is looked for."""
    contact_slack_m: Annotated[float, Field(gt=0.0, le=0.01)] = 0.00025
    """How far soft tissue gives under a light touch; a felt surface that differs less from the seen one corrects nothing."""


class GuardedMove:
    """Lowers the tip onto a surface whose depth is in error mostly along the viewing ray.

    A touch fixes the shift along the ray that puts the seen surface where the felt one is.
    """

    def __init__(self, config: GuardedMoveConfig, motion: TipMotion) -> None:
        self._config = config
        self._motion = motion
        self.shift = 0.0
        """By how much the surface lies farther along the viewing ray than depth says, metres."""
        self.height = 0.0
        """Of the reference above the seen surface, along the approach axis, metres."""

    @property
    def too_early(self) -> bool:
        """Whether a touch now would be one of an obstacle."""
        return self.height > self._config.early_contact_m

    def descend(self, state: ControlInput, geometry: ApproachGeometry, elapsed: float) -> Array:
        """Lower the reference along the approach axis, then along the viewing ray; return the velocity (3,) that follows it.

        The velocity is relative to the surface.
        """
        config = self._config
        step = config.approach_speed_mps * elapsed
        reference = geometry.goal + self.height * geometry.axis
        way = reference - state.tip_in_camera
        back = self._motion.back(way, lead_ns=state.lead_ns)
        if np.linalg.norm(way) > 0.002:
            return back
        if self.height > 0.0:
            self.height = max(self.height - step, 0.0)
            ahead = -geometry.axis
        elif self.shift < config.search_m:
            self.shift += step
            ahead = geometry.ray
        else:
            ahead = np.zeros(3)
        return config.approach_speed_mps * ahead + back

    def feel(self, state: ControlInput, geometry: ApproachGeometry, *, fraction: float) -> None:
        """Shift the seen surface along its viewing ray, by a fraction of what separates it from the felt one."""
        limit, slack = self._config.early_contact_m, self._config.contact_slack_m
        # The seen surface moves against the normal when it moves along the ray.
        gap = float((state.tip_in_camera - geometry.goal) @ geometry.normal)
        gap -= min(max(gap, -slack), slack)
        felt_shift = gap / min(float(geometry.ray @ geometry.normal), -0.3)
        self.shift = min(max(self.shift + fraction * felt_shift, -limit), limit)
