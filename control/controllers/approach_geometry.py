"""Where a tool goes on its way to a target: the points and directions of one tick, in the camera's frame."""

from typing import Annotated

import numpy as np

from laploop.arrays import Array
from laploop.assets.shafts import INSTRUMENT, Shaft
from laploop.configuration import Field, configuration
from laploop.control.messages import ControlInput
from laploop.control.targeting.targeting import Target


@configuration
class ApproachDistances:
    """Distances on the way to a target."""

    shaft: Shaft = INSTRUMENT
    """The instrument."""
    standoff_m: Annotated[float, Field(gt=0.0, le=0.1)] = 0.008
    """Distance from the target, along the way down to it, at which the approach ends."""
    clearance_m: Annotated[float, Field(gt=0.0, le=0.1)] = 0.006
    """Clearance between the tip's path and the highest tissue in view, before the descent."""
    max_climb_m: Annotated[float, Field(gt=0.0, le=0.5)] = 0.035
    """Greatest height of the path above the target, whatever seems to be in view."""


class ApproachGeometry:
    """Points and directions of one tick, in the camera's frame."""

    def __init__(
        self,
        target: Target,
        state: ControlInput,
        distances: ApproachDistances,
        *,
        shift: float = 0.0,
        along_shaft: bool = False,
    ) -> None:
        """Lay out the way.

        Args:
            target: What is known of the target.
            state: Where tip and trocar are.
            distances: Of the way.
            shift: By how much the surface lies farther along the viewing ray than depth says, metres.
            along_shaft: Whether to come down along the shaft; else half-way between it and the normal.
        """
        radius = distances.shaft.tip_radius_m
        self.normal = target.normal
        """Of the surface, towards the camera."""
        self.flow = target.velocity
        """Velocity of the surface."""
        self.age_s = target.age_ns(state.now_ns) * 1e-9
        self.lead_ns = state.lead_ns
        self.ray = unit(target.point)
        self.goal = target.point + shift * self.ray + radius * target.normal
        """Where the tip touches."""
        self.shaft = unit(state.trocar_in_camera - self.goal)
        """From the goal to the trocar: the way out."""
        # The shaft's own direction keeps off neighbouring lobes, the normal keeps the ball from sliding: first between the
        # two, after a bump along the shaft.
        self.axis = self.shaft if along_shaft else unit(target.normal + self.shaft)
        self.standoff = self.goal + distances.standoff_m * self.axis
        self.safe_depth = max(target.nearest_depth - distances.clearance_m - radius, self.goal[2] - distances.max_climb_m)
        """A tip that is nearer to the camera than this is above all tissue."""
        climb = max(self.standoff[2] - self.safe_depth, 0.0) / max(-self.shaft[2], 0.2)
        self.above = self.standoff + climb * self.shaft


def unit(vector: Array) -> Array:
    """Return a vector of length 1."""
    return vector / max(float(np.linalg.norm(vector)), 1e-12)
