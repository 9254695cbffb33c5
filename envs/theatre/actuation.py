"""The path from a joint target to its servo: the robot's own cycle, delay, lag and limits."""

import math
from collections import deque
from dataclasses import replace
from typing import Annotated, ClassVar, Literal, NamedTuple, get_args

import numpy as np

from laploop.arrays import Array
from laploop.assets.ur5_description import VELOCITY_GAIN_RATIO_S
from laploop.configuration import Field, configuration
from laploop.envs.theatre.arm import JointReference
from laploop.errors import InvalidValueError, UnknownNameError

ActuationName = Literal["ideal", "ur5-cb", "ur5-e"]
"""The named actuations, in the order in which they are listed to users."""


@configuration
class ActuationConfig:
    """How a robot follows the joint targets that are streamed to it.

    A target takes effect at the robot's next cycle and holds until the one after; motion begins a delay later and follows with
    a first-order lag. The defaults have none of this: servos extrapolate the target by its velocity.
    """

    cycle_ms: Annotated[float, Field(ge=0.0, le=100.0)] = 0.0
    """Period of the robot's controller, whole physics steps; 0 for none."""
    delay_ms: Annotated[float, Field(ge=0.0, le=1000.0)] = 0.0
    """From the cycle in which a target takes effect to the first motion; rounded up to whole physics steps."""
    lag_ms: Annotated[float, Field(ge=0.0, le=1000.0)] = 0.0
    """Time constant of the first-order lag."""
    max_speed_rad_s: Annotated[float, Field(gt=0.0, le=100.0)] | None = None
    """Limit of every joint's speed."""
    max_angle_rad: Annotated[float, Field(gt=0.0, le=100.0)] | None = None
    """Limit of every joint's angle, in both directions."""

    def __post_init__(self) -> None:
        limited = self.max_speed_rad_s is not None or self.max_angle_rad is not None
        if self.cycle_ms == 0.0 and (self.delay_ms or self.lag_ms or limited):
            raise InvalidValueError("cycle_ms", 0, "above 0 where there is a delay, a lag or a limit")

    @classmethod
    def named(cls, name: str) -> "ActuationConfig":
        """Make one of the named actuations.

        `ur5-cb` is a UR5 of the CB series: 125 Hz, 35 ms from command to motion (measured with MoveIt Servo), `ur5-e` one of
        the e-series: 500 Hz, 34 ms (measured with `servoj`, lookahead 0.03 s). Published loop models add a lag of 20-40 ms:
        the softer gains of the CB series get 30 ms, the e-series 20 ms. Joints turn by at most 180 deg/s and 360 deg.

        Raises:
            UnknownNameError: If there is no actuation of this name.
        """
        if name not in get_args(ActuationName):
            raise UnknownNameError("actuation", name, get_args(ActuationName))
        if name == "ideal":
            return cls()
        limited = cls(cycle_ms=8.0, max_speed_rad_s=math.pi, max_angle_rad=2.0 * math.pi)
        if name == "ur5-cb":
            return replace(limited, delay_ms=35.0, lag_ms=30.0)
        return replace(limited, cycle_ms=2.0, delay_ms=34.0, lag_ms=20.0)

    def check_timestep(self, timestep_ns: int) -> None:
        """Raise an InvalidValueError unless the robot's cycle is a whole number of physics steps."""
        if self.cycle_ns % timestep_ns:
            step = f"{timestep_ns * 1e-6:g} ms"
            raise InvalidValueError("cycle_ms", self.cycle_ms, f"a multiple of the physics step, {step}")

    @property
    def cycle_ns(self) -> int:
        """Period of the robot's controller in nanoseconds."""
        return round(self.cycle_ms * 1e6)

    @property
    def delay_ns(self) -> int:
        """The delay in nanoseconds."""
        return round(self.delay_ms * 1e6)

    @property
    def lag_ns(self) -> int:
        """The time constant in nanoseconds."""
        return round(self.lag_ms * 1e6)

    @property
    def lead_ns(self) -> int:
        """How far ahead a slow reference must be evaluated for the arm to be on it now: delay, lag and half a cycle."""
        return self.delay_ns + self.lag_ns + self.cycle_ns // 2


class _Command(NamedTuple):
    sent_ns: int
    q: Array
    qdot: Array


class Actuation:
    """Carries one arm's joint targets to its servos, at every physics step; deterministic, on whole nanoseconds.

    The servo's input includes the velocity feed-forward `kd / kp q'` for its damping, so that the servo itself adds no lag.
    """

    COMMANDS: ClassVar[int] = 1024
    """Most targets in flight: more than the longest delay holds at one a millisecond."""

    def __init__(self, config: ActuationConfig, *, q: Array, timestep_ns: int, control_steps: int) -> None:
        """Start at rest at q, (joints,) rad; targets are extrapolated by their velocity for `control_steps` physics steps.

        Raises:
            InvalidValueError: If the robot's cycle is not a whole number of physics steps, or q lies beyond its limit.
        """
        config.check_timestep(timestep_ns)
        self.config = config
        self._timestep_ns = timestep_ns
        self._control_steps = control_steps
        self._approach = 1.0 - math.exp(-timestep_ns / config.lag_ns) if config.lag_ns else 1.0
        self._max_step = math.inf if config.max_speed_rad_s is None else config.max_speed_rad_s * timestep_ns * 1e-9
        self._max_angle = math.inf if config.max_angle_rad is None else config.max_angle_rad
        self.reset(q)

    def reset(self, q: Array) -> None:
        """Rest at q, (joints,) rad, with no target in flight.

        Raises:
            InvalidValueError: If q is not finite or lies beyond the limit.
        """
        if not np.all(np.abs(q) <= self._max_angle) or not np.all(np.isfinite(q)):
            raise InvalidValueError("q", q, f"finite angles up to {self._max_angle:g} rad in both directions")
        self._position = np.array(q, dtype=np.float64)
        self._reference = JointReference(
            q=self._position, timestep_s=self._timestep_ns * 1e-9, control_steps=self._control_steps
        )
        self._taken = self._position.copy()
        """The target that the robot's controller held `delay_ns` ago."""
        self._commands: deque[_Command] = deque(maxlen=self.COMMANDS)

    def command(self, now_ns: int, q: Array, qdot: Array | None = None) -> None:
        """Send a target: positions q, (joints,) rad, and velocities qdot, (joints,) rad/s, zero when None.

        Raises:
            InvalidValueError: If q or qdot is not one finite number a joint, or time runs backwards.
        """
        self._reference.set_target(q, qdot)
        if self.config.cycle_ns == 0:
            return
        if self._commands and now_ns < self._commands[-1].sent_ns:
            raise InvalidValueError("now_ns", now_ns, f"no earlier than the last target's {self._commands[-1].sent_ns}")
        speed = np.zeros_like(self._position) if qdot is None else np.array(qdot, dtype=np.float64)
        self._commands.append(_Command(sent_ns=now_ns, q=np.array(q, dtype=np.float64), qdot=speed))

    def step(self, now_ns: int) -> Array:
        """Return the servos' inputs (joints,) for the physics step that begins now; call it once a step."""
        if self.config.cycle_ns == 0:
            return self._reference.advance()
        self._take(now_ns)
        wanted = np.clip(self._taken, -self._max_angle, self._max_angle)
        moved = np.clip(self._approach * (wanted - self._position), -self._max_step, self._max_step)
        self._position = self._position + moved
        return np.asarray(self._position + VELOCITY_GAIN_RATIO_S / (self._timestep_ns * 1e-9) * moved)

    def _take(self, now_ns: int) -> None:
        """Find the target that the robot's controller took in the cycle that acts now, and extrapolate it to that cycle."""
        delayed_ns = now_ns - self.config.delay_ns
        cycle_ns = delayed_ns // self.config.cycle_ns * self.config.cycle_ns
        while len(self._commands) > 1 and self._commands[1].sent_ns <= cycle_ns:
            self._commands.popleft()
        if not self._commands or self._commands[0].sent_ns > cycle_ns:
            return
        newest = self._commands[0]
        age_ns = min(cycle_ns - newest.sent_ns, self._control_steps * self._timestep_ns)
        self._taken = newest.q + age_ns * 1e-9 * newest.qdot
