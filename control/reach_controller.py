"""The scripted reach: above the target, down to a stand-off, to the surface, and a light touch that follows it."""

import math
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from laploop.assets.shafts import INSTRUMENT, Shaft
from laploop.control.messages import ControlInput
from laploop.control.targeting import Target, Targeting, TargetingConfig
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
        self._height = self._config.standoff_m
        self._shift = 0.0
        self._attempts = 0

    def command(self, state: ControlInput) -> Array:
        """Return the desired tip velocity (3,) in m/s in the camera's frame; zero while a reading is not finite."""
        if not (math.isfinite(state.contact_force_n) and np.isfinite(state.tip_in_camera).all()):
            return np.zeros(3)
        elapsed = 0.0 if self._last_ns is None else (state.now_ns - self._last_ns) * 1e-9
        self._last_ns = state.now_ns
        self._target = self._targeting.update(state)
        if self._target is None:
            return np.zeros(3)
        geometry = _Geometry(self._target, state, self._shift, self._config, self._attempts)
        self._change_phase(state, geometry)
        velocity = self._velocity(state, geometry, elapsed)
        speed = float(np.linalg.norm(velocity))
        return velocity * min(1.0, self._config.max_speed_mps / max(speed, 1e-12))

    def _change_phase(self, state: ControlInput, geometry: "_Geometry") -> None:
        config, force = self._config, state.contact_force_n
        free = self._phase in {ReachPhase.RISE, ReachPhase.TRAVEL, ReachPhase.DESCEND}
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
            if self._height > config.early_contact_m:
                self._fail(state)
            else:
                self._feel(geometry, share=1.0)
                self._enter(ReachPhase.TOUCH, state)
        self._advance_free_motion(state, geometry)

    def _advance_free_motion(self, state: ControlInput, geometry: "_Geometry") -> None:
        tip = state.tip_in_camera
        if self._phase is ReachPhase.RISE and tip[2] < geometry.safe_depth + 0.002:
            self._enter(ReachPhase.TRAVEL, state)
        if self._phase is ReachPhase.TRAVEL and np.linalg.norm(geometry.above - tip) < 0.003:
            self._enter(ReachPhase.DESCEND, state)
        fresh = geometry.age_s <= self._config.max_age_s
        if self._phase is ReachPhase.DESCEND and fresh and np.linalg.norm(geometry.standoff - tip) < 0.002:
            self._height = self._config.standoff_m
            self._enter(ReachPhase.APPROACH, state)

    def _velocity(self, state: ControlInput, geometry: "_Geometry", elapsed: float) -> Array:
        tip, flow = state.tip_in_camera, geometry.flow
        match self._phase:
            case ReachPhase.RISE | ReachPhase.RETREAT:
                return 0.5 * self._config.max_speed_mps * geometry.shaft
            case ReachPhase.TRAVEL:
                return flow + self._towards(geometry.above - tip)
            case ReachPhase.DESCEND:
                return flow + self._towards(geometry.standoff - tip)
            case ReachPhase.APPROACH:
                return flow + self._descent(state, geometry, elapsed)
            case ReachPhase.TOUCH:
                return flow + self._touch(state, geometry, elapsed)
            case _:
                return np.zeros(3)

    def _towards(self, way: Array) -> Array:
        distance = max(float(np.linalg.norm(way)), 1e-12)
        config = self._config
        speed = min(
            config.max_speed_mps, math.sqrt(2.0 * config.acceleration_mps2 * distance), config.position_gain_per_s * distance
        )
        return way * (speed / distance)

    def _descent(self, state: ControlInput, geometry: "_Geometry", elapsed: float) -> Array:
        """Lower the reference along the approach axis, then along the viewing ray, and follow it with the tip."""
        config = self._config
        step = config.approach_speed_mps * elapsed
        reference = geometry.goal + self._height * geometry.axis
        way = reference - state.tip_in_camera
        back = self._back_to_the_reference(way)
        if np.linalg.norm(way) > 0.002:
            return back
        if self._height > 0.0:
            self._height = max(self._height - step, 0.0)
            ahead = -geometry.axis
        elif self._shift < config.search_m:
            self._shift += step
            ahead = geometry.ray
        else:
            ahead = np.zeros(3)
        return config.approach_speed_mps * ahead + back

    def _back_to_the_reference(self, way: Array) -> Array:
        """Return the velocity that removes a lag; near tissue that must never be a leap."""
        velocity = self._config.position_gain_per_s * way
        return velocity * min(1.0, self._config.max_catch_up_mps / max(float(np.linalg.norm(velocity)), 1e-12))

    def _touch(self, state: ControlInput, geometry: "_Geometry", elapsed: float) -> Array:
        config, normal, force = self._config, geometry.normal, state.contact_force_n
        if force >= 0.5 * config.contact_force_n:
            self._feel(geometry, share=min(1.0, config.adaptation_per_s * elapsed))
        way = geometry.goal - state.tip_in_camera
        along = float(way @ normal)
        across = self._back_to_the_reference(way - along * normal)
        lift = config.admittance_mps_per_n * (force - config.hold_force_n)
        lift = min(max(lift, -config.max_press_speed_mps), config.max_yield_speed_mps)
        if along > config.search_m and lift < 0.0:
            # Nothing is felt that deep below the surface: go by sight.
            lift = min(config.position_gain_per_s * (along - config.search_m), config.max_yield_speed_mps)
        return across + lift * normal

    def _feel(self, geometry: "_Geometry", *, share: float) -> None:
        """Shift the seen surface along its viewing ray, by a share of what separates it from the felt one."""
        limit = self._config.early_contact_m
        self._shift = min(max(self._shift + share * geometry.felt_shift, -limit), limit)

    def _fail(self, state: ControlInput) -> None:
        self._attempts += 1
        self._shift = 0.0
        self._enter(ReachPhase.RETREAT, state)

    def _enter(self, phase: ReachPhase, state: ControlInput) -> None:
        self._phase = phase
        self._phase_since_ns = state.now_ns


class _Geometry:
    """Points and directions of one tick, in the camera's frame."""

    def __init__(self, target: Target, state: ControlInput, shift: float, config: ReachControllerConfig, attempts: int) -> None:
        radius = config.shaft.tip_radius_m
        self.normal = target.normal
        self.flow = target.velocity
        self.age_s = target.age_ns(state.now_ns) * 1e-9
        self.ray = target.point / np.linalg.norm(target.point)
        self.goal = target.point + shift * self.ray + radius * target.normal
        self.shaft = _unit(state.trocar_in_camera - self.goal)
        # The shaft's own direction keeps off neighbouring lobes, the normal keeps the ball from sliding: first between the
        # two, after a bump along the shaft.
        self.axis = _unit(target.normal + self.shaft) if attempts % 2 == 0 else self.shaft
        self.standoff = self.goal + config.standoff_m * self.axis
        self.safe_depth = max(target.nearest_depth - config.clearance_m - radius, self.goal[2] - config.max_climb_m)
        climb = max(self.standoff[2] - self.safe_depth, 0.0) / max(-self.shaft[2], 0.2)
        self.above = self.standoff + climb * self.shaft
        # The seen surface moves against the normal when it moves along the ray.
        gap = float((state.tip_in_camera - self.goal) @ target.normal)
        gap -= min(max(gap, -config.contact_slack_m), config.contact_slack_m)
        self.felt_shift = gap / min(float(self.ray @ target.normal), -0.3)


def _unit(vector: Array) -> Array:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)
