"""The scripted reach: to the surface, and a light touch that follows it."""

from typing import Annotated

from laploop.arrays import Array
from laploop.configuration import Field, configuration
from laploop.control.controllers.admittance import Admittance
from laploop.control.controllers.approach_geometry import ApproachGeometry
from laploop.control.controllers.phase import Phase
from laploop.control.controllers.touch import TouchController, TouchControllerConfig
from laploop.control.messages import ControlInput
from laploop.control.targeting.targeting import TargetingConfig
from laploop.errors import InvalidValueError


@configuration
class ReachControllerConfig(TouchControllerConfig):
    """Forces and speeds of `ReachController`."""

    targeting: TargetingConfig = Field(default_factory=TargetingConfig)
    """How the target is followed."""
    hold_force_n: Annotated[float, Field(gt=0.0, le=10.0)] = 0.04
    """Force kept up while touching."""
    admittance: Admittance = Field(default_factory=lambda: Admittance(gain_mps_per_n=0.08))
    """How the force is kept."""
    adaptation_per_s: Annotated[float, Field(gt=0.0, le=100.0)] = 3.0
    """How fast the felt surface corrects the seen one while touching."""

    def __post_init__(self) -> None:
        low, high = self.contact_force_n, self.approach.withdraw_force_n
        if not low <= self.hold_force_n <= high:
            allowed = f"contact_force_n ({low}) to approach.withdraw_force_n ({high})"
            raise InvalidValueError("hold_force_n", self.hold_force_n, allowed)


class ReachController(TouchController[ReachControllerConfig]):
    """A `TipController` that touches the target and stays in touch: force decides along the normal, sight across it."""

    config_class = ReachControllerConfig

    def _begin_contact(self, state: ControlInput) -> Phase:  # noqa: ARG002  the base's signature
        return Phase.TOUCH

    def _in_contact(self, state: ControlInput, geometry: ApproachGeometry, elapsed: float) -> Array:
        config, motion = self._config, self._config.approach.motion
        normal, force = geometry.normal, state.contact_force_n
        if force >= 0.5 * config.contact_force_n:
            self._guarded_move.feel(state, geometry, fraction=min(1.0, config.adaptation_per_s * elapsed))
        way = geometry.goal - state.tip_in_camera
        deep = float(way @ normal)
        across = motion.back(way - deep * normal, lead_ns=state.lead_ns)
        lift = config.admittance.lift_mps(force - config.hold_force_n, state.lead_ns)
        beyond = deep - config.guarded_move.search_m
        if beyond > 0.0 and lift < 0.0:
            # Nothing is felt that deep below the surface: go by sight.
            lift = min(motion.position_gain_per_s * beyond, config.admittance.max_yield_speed_mps)
        return across + lift * normal
