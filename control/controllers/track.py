"""Hovering close over a point of tissue that moves."""

from laploop.arrays import Array
from laploop.configuration import configuration
from laploop.control.controllers.approach_geometry import ApproachGeometry
from laploop.control.controllers.hover import HoverController, HoverControllerConfig
from laploop.control.controllers.phase import Phase
from laploop.control.messages import ControlInput


@configuration
class TrackControllerConfig(HoverControllerConfig):
    """What `TrackController` holds, and how it gets there."""


class TrackController(HoverController[TrackControllerConfig]):
    """A `TipController` that holds a stand-off over the target along its normal."""

    config_class = TrackControllerConfig

    def _work(self, state: ControlInput, geometry: ApproachGeometry, elapsed: float) -> Array:
        if self._phase is None:
            self._phase = Phase.HOLD
            self._begin(state, geometry)
        velocity, way = self._sink(state, geometry, elapsed)
        return velocity + self._config.approach.motion.back(way, lead_ns=state.lead_ns)
