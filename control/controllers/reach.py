"""The scripted reach: to the surface, and a light touch that follows it."""

from typing import Annotated

from laploop.arrays import Array
from laploop.configuration import Field, configuration
from laploop.control.controllers.admittance import Admittance, AdmittanceConfig
from laploop.control.controllers.approach_geometry import ApproachGeometry
from laploop.control.controllers.phase import Phase
from laploop.control.controllers.touch import TouchController, TouchControllerConfig
from laploop.control.controllers.unsteadiness import Unsteadiness
from laploop.control.messages import ControlInput
from laploop.control.targeting.targeting import Target, TargetingConfig
from laploop.errors import InvalidValueError


@configuration
class ReachControllerConfig(TouchControllerConfig):
    """Forces and speeds of `ReachController`."""

    targeting: TargetingConfig = Field(default_factory=TargetingConfig)
    """How the target is followed."""
    hold_force_n: Annotated[float, Field(gt=0.0, le=10.0)] = 0.04
    """Force kept up while touching steady tissue."""
    unsteady_force_ns_m: Annotated[float, Field(ge=0.0, le=1000.0)] = 650.0
    """Further force per unsteadiness of the tissue beyond `steady_change_mps`: late depth cannot follow it, and a light touch
    would be lost. Breathing with a heartbeat of 1 mm comes to 0.08 to 0.14 N."""
    steady_change_mps: Annotated[float, Field(ge=0.0, le=1.0)] = 0.00072
    """Unsteadiness that `hold_force_n` bears: root mean square of how the tissue's speed changes from one depth frame to the
    next, measurement noise included. Breathing of 10 mm has 0.3 to 0.6 mm/s, with a heartbeat of 1 mm 0.8 to 1."""
    unsteady_s: Annotated[float, Field(gt=0.0, le=60.0)] = 1.5
    """Time constant of that mean."""
    max_hold_force_n: Annotated[float, Field(gt=0.0, le=10.0)] = 0.15
    """Greatest force that is kept up."""
    admittance: AdmittanceConfig = Field(default_factory=lambda: AdmittanceConfig(gain_mps_per_n=0.08, integral_per_s=9.6))
    """How the force is kept."""
    adaptation_per_s: Annotated[float, Field(gt=0.0, le=100.0)] = 3.0
    """How fast the felt surface corrects the seen one while touching."""

    def __post_init__(self) -> None:
        low, high = self.contact_force_n, self.approach.withdraw_force_n
        if not low <= self.hold_force_n <= high:
            allowed = f"contact_force_n ({low}) to approach.withdraw_force_n ({high})"
            raise InvalidValueError("hold_force_n", self.hold_force_n, allowed)
        if not self.hold_force_n <= self.max_hold_force_n <= high:
            allowed = f"hold_force_n ({self.hold_force_n}) to approach.withdraw_force_n ({high})"
            raise InvalidValueError("max_hold_force_n", self.max_hold_force_n, allowed)


class ReachController(TouchController[ReachControllerConfig]):
    """A `TipController` that touches the target and stays in touch: force decides along the normal, sight across it."""

    config_class = ReachControllerConfig

    def _set_up(self) -> None:
        super()._set_up()
        self._admittance = Admittance(self._config.admittance)

    def reset(self) -> None:
        """Forget everything; a new episode begins."""
        super().reset()
        self._unsteadiness = Unsteadiness(self._config.unsteady_s)

    def _advance(self, state: ControlInput, target: Target | None) -> Array | ApproachGeometry:
        if target is not None:
            self._unsteadiness.add(target.velocity, target.captured_ns)
        return super()._advance(state, target)

    def _begin_contact(self, state: ControlInput) -> Phase:  # noqa: ARG002  the base's signature
        self._admittance.reset()
        return Phase.TOUCH

    def _in_contact(self, state: ControlInput, geometry: ApproachGeometry, elapsed: float) -> Array:
        config, motion = self._config, self._config.approach.motion
        normal, force = geometry.normal, state.contact_force_n
        if force >= 0.5 * config.contact_force_n:
            self._guarded_move.feel(state, geometry, fraction=min(1.0, config.adaptation_per_s * elapsed))
        way = geometry.goal - state.tip_in_camera
        deep = float(way @ normal)
        across = motion.back(way - deep * normal, lead_ns=state.lead_ns)
        unsteady_mps = max(self._unsteadiness.rms_mps - config.steady_change_mps, 0.0)
        wanted = min(config.hold_force_n + config.unsteady_force_ns_m * unsteady_mps, config.max_hold_force_n)
        lift = self._admittance.lift_mps(force - wanted, state.lead_ns, elapsed)
        beyond = deep - config.guarded_move.search_m
        if beyond > 0.0 and lift < 0.0:
            # Nothing is felt that deep below the surface: go by sight.
            lift = min(motion.position_gain_per_s * beyond, config.admittance.max_yield_speed_mps)
        return across + lift * normal
