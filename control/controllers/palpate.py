"""Pressing on a point of tissue with a given force."""

from typing import Annotated

from laploop.arrays import Array
from laploop.configuration import Field, configuration
from laploop.control.controllers.admittance import Admittance, AdmittanceConfig
from laploop.control.controllers.approach_geometry import ApproachGeometry
from laploop.control.controllers.phase import Phase
from laploop.control.controllers.touch import TouchController, TouchControllerConfig
from laploop.control.messages import ControlInput
from laploop.errors import InvalidValueError


@configuration
class PalpateControllerConfig(TouchControllerConfig):
    """Forces and speeds of `PalpateController`."""

    force_n: Annotated[float, Field(gt=0.0, le=10.0)] = 0.5
    """Force to be held."""
    band_n: Annotated[float, Field(gt=0.0, le=10.0)] = 0.1
    """Distance from that force within which the hold begins."""
    force_rate_nps: Annotated[float, Field(gt=0.0, le=100.0)] = 0.5
    """Rate at which the wanted force rises from the touch on."""
    admittance: AdmittanceConfig = Field(default_factory=lambda: AdmittanceConfig(gain_mps_per_n=0.06))
    """How the force is kept."""
    max_indentation_m: Annotated[float, Field(gt=0.0, le=0.1)] = 0.012
    """Depth below the seen surface beyond which the tip does not press, whatever the force says."""

    def __post_init__(self) -> None:
        low, high = self.contact_force_n, self.approach.withdraw_force_n
        if not low <= self.force_n <= high:
            raise InvalidValueError("force_n", self.force_n, f"contact_force_n ({low}) to approach.withdraw_force_n ({high})")


class PalpateController(TouchController[PalpateControllerConfig]):
    """A `TipController` that presses on the target along its normal and keeps the force.

    An admittance turns what is missing of the force into a speed relative to the tissue, whose predicted velocity is added,
    so that breathing costs little force.
    """

    config_class = PalpateControllerConfig

    def _set_up(self) -> None:
        super()._set_up()
        self._admittance = Admittance(self._config.admittance)

    def _leave(self) -> None:
        super()._leave()
        self._wanted_n = 0.0

    def _begin_contact(self, state: ControlInput) -> Phase:
        self._wanted_n = state.contact_force_n
        self._admittance.reset()
        return Phase.PRESS

    def _in_contact(self, state: ControlInput, geometry: ApproachGeometry, elapsed: float) -> Array:
        """Return the velocity (3,), relative to the tissue: force decides along the normal, sight across it."""
        config, normal, motion = self._config, geometry.normal, self._config.approach.motion
        way = geometry.goal - state.tip_in_camera
        deep = float(way @ normal)
        across = motion.back(way - deep * normal, lead_ns=state.lead_ns)
        lift = self._admittance.lift_mps(state.contact_force_n - self._wanted_n, state.lead_ns, elapsed)
        if deep > config.max_indentation_m:
            lift = max(lift, motion.gain(state.lead_ns) * (deep - config.max_indentation_m))
        self._raise_force(state, elapsed)
        return across + min(lift, config.admittance.max_yield_speed_mps) * normal

    def _raise_force(self, state: ControlInput, elapsed: float) -> None:
        """Let the wanted force rise to its full size; the hold begins when the force is near that."""
        config = self._config
        if self._phase is Phase.PRESS:
            self._wanted_n = min(self._wanted_n + config.force_rate_nps * elapsed, config.force_n)
            if self._wanted_n >= config.force_n and abs(state.contact_force_n - config.force_n) <= config.band_n:
                self._phase = Phase.HOLD
