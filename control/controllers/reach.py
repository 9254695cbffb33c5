"""The scripted reach: above the target, down to a stand-off, to the surface, and a light touch that follows it."""

import math
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from laploop.assets.shafts import INSTRUMENT, Shaft
from laploop.control.controllers.approach_geometry import ApproachDistances, ApproachGeometry
from laploop.control.controllers.guarded_move import GuardedMove, GuardedMoveConfig
from laploop.control.controllers.tip_motion import Leg, TipMotion, steady_admittance
from laploop.control.messages import ControlInput
from laploop.control.targeting.targeting import Target, Targeting, TargetingConfig
from laploop.control.vectors import is_finite
from laploop.errors import InvalidValueError
from laploop.perception.geometry import Rig

Array = NDArray[np.float64]


class ReachPhase(StrEnum):
    """What the controller is doing."""

    WAIT = "wait"
    """No frame has shown the target yet: the tip stands still."""
    RISE = "rise"
    """The tool withdraws along its shaft until its tip is above all tissue in view."""
    TRAVEL = "travel"
    """Towards a point above the target from which the shaft's own direction leads to the stand-off."""
    DESCEND = "descend"
    """To the stand-off."""
    APPROACH = "approach"
    """From the stand-off to the surface, and beyond its estimate if nothing is felt there."""
    TOUCH = "touch"
    """Light contact: force decides along the normal, the target's position across it."""
    RETREAT = "retreat"
    """Something pushed hard: back along the shaft until nothing is felt."""


_FREE = frozenset({ReachPhase.RISE, ReachPhase.TRAVEL, ReachPhase.DESCEND})
"""Nothing should be touched yet; the names are those of the legs."""


@dataclass(frozen=True, kw_only=True)
class ReachControllerConfig:
    """Distances, speeds and forces of `ReachController`."""

    shaft: Shaft = INSTRUMENT
    targeting: TargetingConfig = field(default_factory=TargetingConfig)
    max_speed_mps: float = 0.06
    approach_speed_mps: float = 0.010
    """Relative to the tissue, from the stand-off on."""
    max_catch_up_mps: float = 0.020
    """Fastest return to the reference near tissue, relative to it."""
    acceleration_mps2: float = 0.4
    """With which travelling ends at a way-point."""
    position_gain_per_s: float = 8.0
    """Speed per distance from the reference."""
    standoff_m: float = 0.008
    clearance_m: float = 0.006
    """Between the tip's path and the highest tissue in view, before the descent."""
    max_climb_m: float = 0.035
    """Highest that the path passes above the target, whatever seems to be in view."""
    early_contact_m: float = 0.005
    """A touch farther than this before the estimated surface is an obstacle, not the target."""
    search_m: float = 0.003
    """How far beyond the estimated surface contact is looked for."""
    contact_force_n: float = 0.03
    """What counts as a touch."""
    hold_force_n: float = 0.04
    """Kept up while touching."""
    contact_slack_m: float = 0.00025
    """How far soft tissue gives under a light touch; a felt surface that differs less from the seen one corrects nothing."""
    admittance_mps_per_n: float = 0.08
    """Speed along the normal per newton of too much or too little force."""
    max_press_speed_mps: float = 0.006
    max_yield_speed_mps: float = 0.030
    alarm_force_n: float = 1.2
    """Above this the tool withdraws, whatever it was doing."""
    bump_force_n: float = 0.3
    """The same, while it should not touch anything."""
    retreat_s: float = 0.2
    """Shortest duration of a retreat."""
    adaptation_per_s: float = 3.0
    """How fast the felt surface corrects the seen one while touching."""
    max_age_s: float = 0.5
    """With the target unseen for longer, the tool goes back to the stand-off and waits."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a number is not finite and above 0, or forces are not in order.
        """
        for name, value in vars(self).items():
            if isinstance(value, int | float) and not 0.0 < value < math.inf:
                raise InvalidValueError(name, value, "finite and above 0")
        forces = (self.contact_force_n, self.hold_force_n, self.bump_force_n, self.alarm_force_n)
        if list(forces) != sorted(forces):
            raise InvalidValueError("contact, hold, bump and alarm force", forces, "in rising order")


class ReachController:
    """A `TipController` that touches the target and stays in touch.

    The target's surface is known by depth along its viewing ray, with an error mostly along that ray. So the last
    millimetres are felt: a touch fixes the shift along the ray that puts the seen surface where the felt one is.
    """

    def __init__(self, rig: Rig, config: ReachControllerConfig | None = None) -> None:
        """Take the camera's geometry."""
        self._config = config = config or ReachControllerConfig()
        self._targeting = Targeting(rig, config.targeting)
        self._motion = TipMotion(
            max_speed_mps=config.max_speed_mps,
            max_catch_up_mps=config.max_catch_up_mps,
            acceleration_mps2=config.acceleration_mps2,
            position_gain_per_s=config.position_gain_per_s,
        )
        self._distances = ApproachDistances(
            shaft=config.shaft,
            standoff_m=config.standoff_m,
            clearance_m=config.clearance_m,
            max_climb_m=config.max_climb_m,
        )
        self._guarded_move = GuardedMove(
            GuardedMoveConfig(
                approach_speed_mps=config.approach_speed_mps,
                early_contact_m=config.early_contact_m,
                search_m=config.search_m,
                contact_slack_m=config.contact_slack_m,
            ),
            self._motion,
        )
        self.reset()

    @property
    def phase(self) -> ReachPhase:
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
        self._phase = ReachPhase.WAIT
        self._phase_since_ns = 0
        self._last_ns: int | None = None
        self._guarded_move.height = self._config.standoff_m
        self._guarded_move.shift = 0.0
        self._attempts = 0
        self._way_out = np.zeros(3)

    def command(self, state: ControlInput) -> Array:
        """Return the desired tip velocity (3,) in m/s in the camera's frame.

        While a reading is not finite the tip stands still far from tissue, and withdraws along its shaft from tissue.
        """
        if not (math.isfinite(state.contact_force_n) and is_finite(state.tip_in_camera)):
            return self._blind(state)
        elapsed = 0.0 if self._last_ns is None else (state.now_ns - self._last_ns) * 1e-9
        self._last_ns = state.now_ns
        self._target = self._targeting.update(state)
        if self._target is None:
            return np.zeros(3)
        geometry = ApproachGeometry(
            self._target, state, self._distances, shift=self._guarded_move.shift, along_shaft=self._attempts % 2 == 1
        )
        self._way_out = geometry.shaft
        self._change_phase(state, geometry)
        return self._motion.bounded(self._velocity(state, geometry, elapsed))

    def _blind(self, state: ControlInput) -> Array:
        if self._phase in {ReachPhase.APPROACH, ReachPhase.TOUCH}:
            self._fail(state)
        return 0.5 * self._config.max_speed_mps * self._way_out if self._phase is ReachPhase.RETREAT else np.zeros(3)

    def _change_phase(self, state: ControlInput, geometry: ApproachGeometry) -> None:
        config, force = self._config, state.contact_force_n
        free = self._phase in _FREE
        touched = force >= config.contact_force_n
        if self._phase is ReachPhase.RETREAT:
            if force < config.contact_force_n and state.now_ns - self._phase_since_ns >= config.retreat_s * 1e9:
                self._enter(ReachPhase.RISE, state)
        elif force >= (config.bump_force_n if free else config.alarm_force_n):
            self._fail(state)
        elif self._phase is ReachPhase.WAIT:
            self._enter(ReachPhase.RISE, state)
        elif geometry.age_s > config.max_age_s and self._phase in {ReachPhase.APPROACH, ReachPhase.TOUCH}:
            self._enter(ReachPhase.DESCEND, state)
        elif self._phase is ReachPhase.APPROACH and touched:
            if self._guarded_move.too_early:
                self._fail(state)
            else:
                self._guarded_move.feel(state, geometry, share=1.0)
                self._enter(ReachPhase.TOUCH, state)
        self._advance_free_motion(state, geometry)

    def _advance_free_motion(self, state: ControlInput, geometry: ApproachGeometry) -> None:
        if self._phase not in _FREE:
            return
        leg = Leg(self._phase.value)
        in_sight = geometry.age_s <= self._config.max_age_s
        following = self._motion.leg_after(leg, state.tip_in_camera, geometry, in_sight=in_sight)
        if following is Leg.ARRIVED:
            self._guarded_move.height = self._config.standoff_m
            self._enter(ReachPhase.APPROACH, state)
        elif following is not leg:
            self._enter(ReachPhase(following.value), state)

    def _velocity(self, state: ControlInput, geometry: ApproachGeometry, elapsed: float) -> Array:
        match self._phase:
            case ReachPhase.RISE | ReachPhase.RETREAT:
                return self._motion.along(Leg.RISE, state.tip_in_camera, geometry)
            case ReachPhase.TRAVEL | ReachPhase.DESCEND:
                return self._motion.along(Leg(self._phase.value), state.tip_in_camera, geometry)
            case ReachPhase.APPROACH:
                return geometry.flow + self._guarded_move.descend(state, geometry, elapsed)
            case ReachPhase.TOUCH:
                return geometry.flow + self._touch(state, geometry, elapsed)
            case _:
                return np.zeros(3)

    def _touch(self, state: ControlInput, geometry: ApproachGeometry, elapsed: float) -> Array:
        config, normal, force = self._config, geometry.normal, state.contact_force_n
        if force >= 0.5 * config.contact_force_n:
            self._guarded_move.feel(state, geometry, share=min(1.0, config.adaptation_per_s * elapsed))
        way = geometry.goal - state.tip_in_camera
        along = float(way @ normal)
        across = self._motion.back(way - along * normal, lead_ns=state.lead_ns)
        admittance = steady_admittance(config.admittance_mps_per_n, state.lead_ns)
        lift = admittance * (force - config.hold_force_n)
        lift = min(max(lift, -config.max_press_speed_mps), config.max_yield_speed_mps)
        if along > config.search_m and lift < 0.0:
            # Nothing is felt that deep below the surface: go by sight.
            lift = min(config.position_gain_per_s * (along - config.search_m), config.max_yield_speed_mps)
        return across + lift * normal

    def _fail(self, state: ControlInput) -> None:
        self._attempts += 1
        self._guarded_move.shift = 0.0
        self._enter(ReachPhase.RETREAT, state)

    def _enter(self, phase: ReachPhase, state: ControlInput) -> None:
        self._phase = phase
        self._phase_since_ns = state.now_ns
