"""The way to a stand-off over a target, and the way back whenever something is wrong."""

import math
from itertools import pairwise
from typing import Annotated

import numpy as np

from laploop.arrays import Array
from laploop.configuration import Field, configuration
from laploop.control.controllers.approach_geometry import ApproachDistances, ApproachGeometry
from laploop.control.controllers.phase import Phase
from laploop.control.controllers.tip_motion import TipMotion
from laploop.control.messages import ControlInput
from laploop.control.targeting.targeting import Target
from laploop.errors import InvalidValueError

Force = Annotated[float, Field(gt=0.0, le=100.0)]

_LEGS = frozenset({Phase.RISE, Phase.TRAVEL, Phase.DESCEND})


@configuration
class SafeApproachConfig:
    """Speeds, distances, and what counts as wrong."""

    motion: TipMotion = Field(default_factory=TipMotion)
    """How fast the tip goes."""
    distances: ApproachDistances = Field(default_factory=ApproachDistances)
    """Where it goes."""
    clear_force_n: Force = 0.03
    """Force below which nothing is touched."""
    bump_force_n: Force = 0.3
    """Force from which the tool withdraws while it should not touch anything."""
    withdraw_force_n: Force = 1.2
    """Force from which the tool withdraws while it works in contact."""
    alarm_force_n: Force = 2.0
    """Force from which `alarm` is up until `reset`."""
    stop_force_n: Force = 5.0
    """Force from which the tool withdraws for good."""
    retreat_s: Annotated[float, Field(gt=0.0, le=10.0)] = 0.2
    """Shortest duration of a retreat."""
    max_age_s: Annotated[float, Field(gt=0.0, le=10.0)] = 0.5
    """Time since the target was seen after which the tool backs off and waits."""
    lost_standoff_m: Annotated[float, Field(gt=0.0, le=0.1)] = 0.015
    """Distance from where the target was last seen at which it waits; more than the stroke of breathing."""
    patience_s: Annotated[float, Field(gt=0.0, le=60.0)] = 3.0
    """Time without progress after which the target counts as unreachable."""

    def __post_init__(self) -> None:
        names = ("clear_force_n", "bump_force_n", "withdraw_force_n", "alarm_force_n", "stop_force_n")
        for lower, higher in pairwise(names):
            if getattr(self, higher) < getattr(self, lower):
                raise InvalidValueError(higher, getattr(self, higher), f"at least {lower} ({getattr(self, lower)})")


class SafeApproach:
    """Brings the tip to a stand-off, then lets a task work, and takes over again whenever something is wrong."""

    def __init__(self, config: SafeApproachConfig | None = None) -> None:
        self._config = config or SafeApproachConfig()
        self.reset()

    def reset(self) -> None:
        """Wait for a target."""
        self._phase = Phase.WAIT
        self._since_ns = 0
        self._attempts = 0
        self._alarm = False
        self._way_out = np.zeros(3)
        self._least_left_m = math.inf
        self._progress_ns = 0

    @property
    def phase(self) -> Phase:
        """Where on its way the tool is, or what keeps it off."""
        return self._phase

    @property
    def alarm(self) -> bool:
        """Whether a force at or above the alarm has been read since `reset`."""
        return self._alarm

    def advance(
        self, state: ControlInput, target: Target | None, *, shift: float = 0.0, contact: bool = False
    ) -> Array | ApproachGeometry:
        """Return the velocity (3,) of the approach, or the geometry of this tick when the task may work.

        Args:
            state: What is known at this tick.
            target: What is known of the target.
            shift: By how much the surface lies farther along the viewing ray than depth says, metres.
            contact: Whether the task means to touch.
        """
        if not (math.isfinite(state.contact_force_n) and np.isfinite(state.tip_in_camera).all()):
            return self._blind(state)
        if target is None:
            return np.zeros(3)
        distances = self._config.distances
        geometry = ApproachGeometry(target, state, distances, shift=shift, along_shaft=self._attempts % 2 == 1)
        self._way_out = geometry.shaft
        self._judge(state, geometry, contact=contact)
        if self._phase in _LEGS:
            self._follow_legs(state, geometry)
        return geometry if self._phase is Phase.READY else self._velocity(state, geometry)

    def withdraw(self, state: ControlInput) -> Array:
        """Give this attempt up: out along the shaft, and try again another way; return the velocity (3,)."""
        self._attempts += 1
        self._enter(Phase.RETREAT, state)
        return 0.5 * self._config.motion.max_speed_mps * self._way_out

    def _judge(self, state: ControlInput, geometry: ApproachGeometry, *, contact: bool) -> None:
        """Change the phase for what force, age or the end of a withdrawal ask."""
        config, force, phase = self._config, state.contact_force_n, self._phase
        self._alarm = self._alarm or force >= config.alarm_force_n
        working = phase is Phase.READY
        if phase is Phase.STOPPED:
            return
        if force >= config.stop_force_n:
            self._enter(Phase.STOPPED, state)
        elif phase is Phase.RETREAT:
            if force < config.clear_force_n and state.now_ns - self._since_ns >= config.retreat_s * 1e9:
                self._enter(Phase.RISE, state)
        elif force >= (config.withdraw_force_n if working and contact else config.bump_force_n):
            self.withdraw(state)
        elif phase is Phase.WAIT:
            self._enter(Phase.RISE, state)
        elif geometry.age_s > config.max_age_s and phase in {Phase.READY, Phase.DESCEND}:
            self._enter(Phase.BACK_OFF, state)
        elif geometry.age_s <= config.max_age_s and phase is Phase.BACK_OFF:
            self._enter(Phase.DESCEND, state)

    def _follow_legs(self, state: ControlInput, geometry: ApproachGeometry) -> None:
        tip = state.tip_in_camera
        following = self._config.motion.leg_after(self._phase, tip, geometry)
        if following is not self._phase:
            self._enter(following, state)
        if following is Phase.READY:
            return
        if following is Phase.RISE:
            left = float(tip[2] - geometry.safe_depth)
        else:
            end = geometry.above if following is Phase.TRAVEL else geometry.standoff
            left = float(np.linalg.norm(end - tip))
        if left < self._least_left_m - 0.001:
            self._least_left_m, self._progress_ns = left, state.now_ns
        elif state.now_ns - self._progress_ns > self._config.patience_s * 1e9:
            self._enter(Phase.UNREACHABLE, state)

    def _velocity(self, state: ControlInput, geometry: ApproachGeometry) -> Array:
        config, tip = self._config, state.tip_in_camera
        match self._phase:
            case Phase.RISE | Phase.TRAVEL | Phase.DESCEND:
                velocity = config.motion.along(self._phase, tip, geometry)
            case Phase.BACK_OFF:
                out = geometry.goal + config.lost_standoff_m * geometry.shaft - tip
                velocity = config.motion.towards(out, lead_ns=state.lead_ns)
            case Phase.RETREAT:
                velocity = config.motion.along(Phase.RISE, tip, geometry)
            case Phase.STOPPED if tip[2] > geometry.safe_depth:
                velocity = config.motion.along(Phase.RISE, tip, geometry)
            case _:
                velocity = np.zeros(3)
        return config.motion.bounded(velocity)

    def _blind(self, state: ControlInput) -> Array:
        """Withdraw along the last known way out for as long as force or tip are unknown."""
        if self._phase is Phase.WAIT:
            return np.zeros(3)
        if self._phase not in {Phase.RETREAT, Phase.STOPPED}:
            self.withdraw(state)
        return 0.5 * self._config.motion.max_speed_mps * self._way_out

    def _enter(self, phase: Phase, state: ControlInput) -> None:
        self._phase = phase
        self._since_ns = self._progress_ns = state.now_ns
        self._least_left_m = math.inf
