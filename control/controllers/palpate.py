"""Pressing on a point of tissue with a given force."""

import math
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from laploop.control.controllers.approach_geometry import ApproachGeometry
from laploop.control.controllers.guarded_move import GuardedMove, GuardedMoveConfig
from laploop.control.controllers.safe_approach import SafeApproach, SafeApproachConfig
from laploop.control.controllers.tip_motion import steady_admittance
from laploop.control.messages import ControlInput
from laploop.control.prediction.motion_predictor import MotionPredictor
from laploop.control.targeting.targeting import Target, Targeting, TargetingConfig
from laploop.errors import InvalidValueError
from laploop.perception.geometry import Rig

Array = NDArray[np.float64]


class PalpatePhase(StrEnum):
    """What the controller does once it is at the stand-off."""

    APPROACH = "approach"
    """From the stand-off to the surface, and beyond its estimate if nothing is felt there."""
    PRESS = "press"
    """The wanted force rises to its full size."""
    HOLD = "hold"
    """The wanted force is kept."""


@dataclass(frozen=True, kw_only=True)
class PalpateControllerConfig:
    """Forces and speeds of `PalpateController`."""

    targeting: TargetingConfig = field(default_factory=lambda: TargetingConfig(prediction="rhythms"))
    approach: SafeApproachConfig = field(default_factory=SafeApproachConfig)
    feeler: GuardedMoveConfig = field(default_factory=GuardedMoveConfig)
    force_n: float = 0.5
    """To be held."""
    band_n: float = 0.1
    """The hold begins when the force is that near."""
    force_rate_nps: float = 0.5
    """At which the wanted force rises from the touch on."""
    contact_force_n: float = 0.03
    """What counts as a touch."""
    admittance_mps_per_n: float = 0.06
    """Speed along the normal per newton of too much or too little force."""
    max_press_speed_mps: float = 0.006
    max_yield_speed_mps: float = 0.030
    max_indentation_m: float = 0.012
    """Deeper than this below the seen surface the tip does not press, whatever the force says."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a number is not finite and above 0, or forces are not in order.
        """
        for name, value in vars(self).items():
            if isinstance(value, int | float) and not 0.0 < value < math.inf:
                raise InvalidValueError(name, value, "finite and above 0")
        forces = (self.contact_force_n, self.force_n, self.approach.withdraw_force_n)
        if list(forces) != sorted(forces):
            raise InvalidValueError("contact force, force and the approach's withdraw force", forces, "in rising order")


class PalpateController:
    """A `TipController` that presses on the target along its normal and keeps the force.

    An admittance turns what is missing of the force into a speed relative to the tissue, whose predicted velocity is added,
    so that breathing costs little force. Too much force, a lost target and readings that are not numbers are the approach's
    business, and end in a withdrawal.
    """

    def __init__(
        self, rig: Rig, config: PalpateControllerConfig | None = None, predictor: MotionPredictor | None = None
    ) -> None:
        """Take the camera's geometry, and a predictor to use in place of the one that the config names."""
        self._config = config = config or PalpateControllerConfig()
        self._targeting = Targeting(rig, config.targeting, predictor)
        self._approach = SafeApproach(config.approach)
        self._guarded_move = GuardedMove(config.feeler, config.approach.motion)
        self.reset()

    @property
    def phase(self) -> str:
        """What the controller is doing: a phase of the approach, or one of `PalpatePhase`."""
        return self._approach.phase.value if self._phase is None else self._phase.value

    @property
    def alarm(self) -> bool:
        """Whether the alarm force has been read since `reset`."""
        return self._approach.alarm

    @property
    def target(self) -> Target | None:
        """What is known of the target, from the last tick."""
        return self._target

    def reset(self) -> None:
        """Forget everything; a new episode begins."""
        self._targeting.reset()
        self._approach.reset()
        self._target: Target | None = None
        self._phase: PalpatePhase | None = None
        self._guarded_move.shift = 0.0
        self._wanted_n = 0.0
        self._last_ns: int | None = None

    def command(self, state: ControlInput) -> Array:
        """Return the desired tip velocity (3,) in m/s in the camera's frame."""
        elapsed = 0.0 if self._last_ns is None else (state.now_ns - self._last_ns) * 1e-9
        self._last_ns = state.now_ns
        self._target = self._targeting.update(state)
        contact = self._phase is not None
        velocity = self._approach.advance(state, self._target, shift=self._guarded_move.shift, contact=contact)
        geometry = self._approach.geometry
        if velocity is not None or geometry is None:
            self._phase = None
            self._guarded_move.shift = 0.0
            return np.zeros(3) if velocity is None else velocity
        self._change_phase(state, geometry, elapsed)
        if self._phase is PalpatePhase.APPROACH:
            work = self._guarded_move.descend(state, geometry, elapsed)
        else:
            work = self._press(state, geometry)
        return self._config.approach.motion.bounded(geometry.flow + work)

    def _change_phase(self, state: ControlInput, geometry: ApproachGeometry, elapsed: float) -> None:
        config = self._config
        if self._phase is None:
            self._phase = PalpatePhase.APPROACH
            self._guarded_move.height = config.approach.distances.standoff_m
        elif self._phase is PalpatePhase.APPROACH and state.contact_force_n >= config.contact_force_n:
            if self._guarded_move.too_early:
                self._approach.withdraw(state)
                return
            self._guarded_move.feel(state, geometry, share=1.0)
            self._wanted_n = state.contact_force_n
            self._phase = PalpatePhase.PRESS
        elif self._phase is PalpatePhase.PRESS:
            self._wanted_n = min(self._wanted_n + config.force_rate_nps * elapsed, config.force_n)
            if self._wanted_n >= config.force_n and abs(state.contact_force_n - config.force_n) <= config.band_n:
                self._phase = PalpatePhase.HOLD

    def _press(self, state: ControlInput, geometry: ApproachGeometry) -> Array:
        """Return the velocity (3,), relative to the tissue: force decides along the normal, sight across it."""
        config, normal, motion = self._config, geometry.normal, self._config.approach.motion
        way = geometry.goal - state.tip_in_camera
        deep = float(way @ normal)
        across = motion.back(way - deep * normal, lead_ns=state.lead_ns)
        admittance = steady_admittance(config.admittance_mps_per_n, state.lead_ns)
        lift = admittance * (state.contact_force_n - self._wanted_n)
        lift = min(max(lift, -config.max_press_speed_mps), config.max_yield_speed_mps)
        if deep > config.max_indentation_m:
            lift = max(lift, motion.gain(state.lead_ns) * (deep - config.max_indentation_m))
        return across + min(lift, config.max_yield_speed_mps) * normal
