"""What controllers that hover close over tissue have in common."""

from typing import Annotated, TypeVar

from laploop.arrays import Array
from laploop.configuration import Field, configuration
from laploop.control.controllers.approach_geometry import ApproachGeometry
from laploop.control.controllers.base import ApproachController, ApproachControllerConfig
from laploop.control.messages import ControlInput
from laploop.errors import InvalidValueError


@configuration
class HoverControllerConfig(ApproachControllerConfig):
    """Where the tip hovers, and how it gets there."""

    standoff_m: Annotated[float, Field(gt=0.0, le=0.1)] = 0.003
    """Distance between the surface and the ball end, along the normal."""
    approach_speed_mps: Annotated[float, Field(gt=0.0, le=0.2)] = 0.010
    """Speed along the normal, relative to the tissue, from the approach's stand-off to this one."""

    def __post_init__(self) -> None:
        farthest = self.approach.distances.standoff_m
        if self.standoff_m > farthest:
            raise InvalidValueError("standoff_m", self.standoff_m, f"at most approach.distances.standoff_m ({farthest})")


HoverConfigT = TypeVar("HoverConfigT", bound=HoverControllerConfig)


class HoverController(ApproachController[HoverConfigT]):
    """A controller that lowers the tip to a stand-off over the surface and then follows it.

    It commands the surface's predicted velocity at the time when the command takes effect, and removes what is left of the
    error by a bounded proportional term. Nothing should be touched: a bump makes it withdraw.
    """

    def _begin(self, state: ControlInput, geometry: ApproachGeometry) -> None:
        """Start from the height at which the approach has ended."""
        height = float((state.tip_in_camera - geometry.goal) @ geometry.normal)
        self._height = max(height, self._config.standoff_m)

    def _sink(self, state: ControlInput, geometry: ApproachGeometry, elapsed: float) -> tuple[Array, Array]:
        """Lower the reference; return its velocity and the way to it, each (3,)."""
        config = self._config
        sink = min(config.approach_speed_mps * elapsed, self._height - config.standoff_m)
        self._height -= sink
        velocity = geometry.flow
        if elapsed > 0.0:
            velocity = velocity - sink / elapsed * geometry.normal
        return velocity, geometry.goal + self._height * geometry.normal - state.tip_in_camera
