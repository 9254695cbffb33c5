"""The way to a stand-off over a target, and the way back whenever something is wrong."""

import math
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from laploop.control.controllers.approach_geometry import ApproachDistances, ApproachGeometry
from laploop.control.controllers.tip_motion import Leg, TipMotion
from laploop.control.messages import ControlInput
from laploop.control.targeting.targeting import Target
from laploop.control.vectors import is_finite, length
from laploop.errors import InvalidValueError

Array = NDArray[np.float64]


class ApproachPhase(StrEnum):
    """Where on its way the tool is, or what keeps it off."""

    WAIT = "wait"
    """No frame has shown the target yet: the tip stands still."""
    RISE = "rise"
    TRAVEL = "travel"
    DESCEND = "descend"
    """The legs to the stand-off."""
    READY = "ready"
    """At the stand-off or beyond it: the task may work."""
    BACK_OFF = "back-off"
    """The target has not been seen for too long: out along the shaft to a distance that no motion of it bridges, and wait."""
    RETREAT = "retreat"
    """Something pushed hard, or a reading is not a number: out along the shaft."""
    UNREACHABLE = "unreachable"
    """No progress on the way for too long, as at a limit of the arm: the tip stands still."""
    STOPPED = "stopped"
    """A force that must not be: out along the shaft until clear of all tissue, and there the end until `reset`."""


_LEGS = frozenset({ApproachPhase.RISE, ApproachPhase.TRAVEL, ApproachPhase.DESCEND})


@dataclass(frozen=True, kw_only=True)
class SafeApproachConfig:
    """Speeds, distances, and what counts as wrong."""

    motion: TipMotion = field(default_factory=TipMotion)
    distances: ApproachDistances = field(default_factory=ApproachDistances)
    clear_force_n: float = 0.03
    """Below this nothing is touched."""
    bump_force_n: float = 0.3
    """From this on the tool withdraws while it should not touch anything."""
    withdraw_force_n: float = 1.2
    """The same while it works in contact."""
    alarm_force_n: float = 2.0
    """From this on `alarm` is up until `reset`."""
    stop_force_n: float = 5.0
    """From this on the tool withdraws for good."""
    retreat_s: float = 0.2
    """Shortest duration of a retreat."""
    max_age_s: float = 0.5
    """With the target unseen for longer, the tool backs off and waits."""
    lost_standoff_m: float = 0.015
    """So far from where it was last seen; more than the stroke of breathing."""
    patience_s: float = 3.0
    """Without progress for so long the target counts as unreachable."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a number is not finite and above 0, or forces are not in order.
        """
        for name, value in vars(self).items():
            if isinstance(value, int | float) and not 0.0 < value < math.inf:
                raise InvalidValueError(name, value, "finite and above 0")
        forces = (self.clear_force_n, self.bump_force_n, self.withdraw_force_n, self.alarm_force_n, self.stop_force_n)
        if list(forces) != sorted(forces):
            raise InvalidValueError("clear, bump, withdraw, alarm and stop force", forces, "in rising order")


class SafeApproach:
    """Brings the tip to a stand-off, then lets a task work, and takes over again whenever something is wrong."""

    def __init__(self, config: SafeApproachConfig | None = None) -> None:
        """Start waiting."""
        self._config = config or SafeApproachConfig()
        self.reset()

    def reset(self) -> None:
        """Wait for a target."""
        self._phase = ApproachPhase.WAIT
        self._since_ns = 0
        self._attempts = 0
        self._alarm = False
        self._way_out = np.zeros(3)
        self._least_left = math.inf
        self._progress_ns = 0
        self.geometry: ApproachGeometry | None = None

    @property
    def phase(self) -> ApproachPhase:
        """Where on its way the tool is, or what keeps it off."""
        return self._phase

    @property
    def alarm(self) -> bool:
        """Whether a force at or above the alarm has been read since `reset`."""
        return self._alarm

    def advance(self, state: ControlInput, target: Target | None, *, shift: float = 0.0, contact: bool = False) -> Array | None:
        """Return the velocity (3,) of the approach, or None when the task may work.

        Args:
            state: What is known at this tick.
            target: What is known of the target.
            shift: By how much the surface lies farther along the viewing ray than depth says, metres.
            contact: Whether the task means to touch.
        """
        force, tip = state.contact_force_n, state.tip_in_camera
        if not (math.isfinite(force) and is_finite(tip)):
            return self._blind(state)
        if target is None:
            return np.zeros(3)
        distances = self._config.distances
        geometry = ApproachGeometry(target, state, distances, shift=shift, along_shaft=self._attempts % 2 == 1)
        self.geometry = geometry
        self._way_out = geometry.shaft
        self._judge(state, geometry, contact=contact)
        if self._phase in _LEGS:
            self._follow_legs(state, geometry)
        return self._velocity(state, geometry)

    def withdraw(self, state: ControlInput) -> None:
        """Give this attempt up: out along the shaft, and try again another way."""
        self._attempts += 1
        self._enter(ApproachPhase.RETREAT, state)

    def _judge(self, state: ControlInput, geometry: ApproachGeometry, *, contact: bool) -> None:
        """Change the phase for what force, age or the end of a withdrawal ask."""
        config, force, phase = self._config, state.contact_force_n, self._phase
        self._alarm = self._alarm or force >= config.alarm_force_n
        working = phase is ApproachPhase.READY
        if phase is ApproachPhase.STOPPED:
            return
        if force >= config.stop_force_n:
            self._enter(ApproachPhase.STOPPED, state)
        elif phase is ApproachPhase.RETREAT:
            if force < config.clear_force_n and state.now_ns - self._since_ns >= config.retreat_s * 1e9:
                self._enter(ApproachPhase.RISE, state)
        elif force >= (config.withdraw_force_n if working and contact else config.bump_force_n):
            self.withdraw(state)
        elif phase is ApproachPhase.WAIT:
            self._enter(ApproachPhase.RISE, state)
        elif geometry.age_s > config.max_age_s and phase in {ApproachPhase.READY, ApproachPhase.DESCEND}:
            self._enter(ApproachPhase.BACK_OFF, state)
        elif geometry.age_s <= config.max_age_s and phase is ApproachPhase.BACK_OFF:
            self._enter(ApproachPhase.DESCEND, state)

    def _follow_legs(self, state: ControlInput, geometry: ApproachGeometry) -> None:
        tip = state.tip_in_camera
        leg = Leg(self._phase.value)
        following = self._config.motion.leg_after(leg, tip, geometry, in_sight=True)
        if following is Leg.ARRIVED:
            self._enter(ApproachPhase.READY, state)
            return
        if following is not leg:
            self._enter(ApproachPhase(following.value), state)
        ways = {Leg.RISE: tip[2] - geometry.safe_depth, Leg.TRAVEL: length(geometry.above - tip)}
        left = float(ways.get(following, length(geometry.standoff - tip)))
        if left < self._least_left - 0.001:
            self._least_left, self._progress_ns = left, state.now_ns
        elif state.now_ns - self._progress_ns > self._config.patience_s * 1e9:
            self._enter(ApproachPhase.UNREACHABLE, state)

    def _velocity(self, state: ControlInput, geometry: ApproachGeometry) -> Array | None:
        config, tip = self._config, state.tip_in_camera
        match self._phase:
            case ApproachPhase.READY:
                return None
            case ApproachPhase.RISE | ApproachPhase.TRAVEL | ApproachPhase.DESCEND:
                velocity = config.motion.along(Leg(self._phase.value), tip, geometry)
            case ApproachPhase.BACK_OFF:
                out = geometry.goal + config.lost_standoff_m * geometry.shaft - tip
                velocity = config.motion.towards(out, lead_ns=state.lead_ns)
            case ApproachPhase.RETREAT:
                velocity = config.motion.along(Leg.RISE, tip, geometry)
            case ApproachPhase.STOPPED if tip[2] > geometry.safe_depth:
                velocity = config.motion.along(Leg.RISE, tip, geometry)
            case _:
                velocity = np.zeros(3)
        return config.motion.bounded(velocity)

    def _blind(self, state: ControlInput) -> Array:
        """Withdraw along the last known way out for as long as force or tip are unknown."""
        if self._phase is ApproachPhase.WAIT:
            return np.zeros(3)
        if self._phase not in {ApproachPhase.RETREAT, ApproachPhase.STOPPED}:
            self.withdraw(state)
        return 0.5 * self._config.motion.max_speed_mps * self._way_out

    def _enter(self, phase: ApproachPhase, state: ControlInput) -> None:
        self._phase = phase
        self._since_ns = self._progress_ns = state.now_ns
        self._least_left = math.inf
