"""The bounds of one step of every joint, gathered into one box."""

import numpy as np
from numpy.typing import NDArray
from pink import Configuration
from pink.limits import Limit

from laploop.control.arm.model import read_only

Array = NDArray[np.float64]

_POSITION_GAIN = 0.5
"""Share of the way to a position limit that one step may use."""


class JointBoxLimit(Limit):
    """Position, speed and acceleration limits of all joints as one pair of bounds a joint.

    With the last velocity v and the way r left to a position limit, a step of length h may go towards that limit by at most

        min(v_max h, r / 2, (v + a_max h) h, sqrt(2 a_max r) h);

    the last term is the speed from which the joint can still brake (Flacco, De Luca and Khatib, IEEE Trans Robot 2015;31:637).
    Pink has a limit of its own for each of these; one box has a third of their rows, which halves the time of a step.
    """

    def __init__(self, lower: Array, upper: Array, max_speed: Array, max_acceleration: Array | None) -> None:
        """Take the limits of all joints, each (nv,), in rad, rad/s and rad/s^2; without acceleration, that is not limited."""
        joints = len(lower)
        # Twice: towards the upper limits, then towards the lower ones, where all signs are turned.
        self._joints = joints
        self._limits = read_only(np.concatenate([upper, -lower]))
        self._max_speed = read_only(np.tile(max_speed, 2))
        self._max_acceleration = None if max_acceleration is None else read_only(np.tile(max_acceleration, 2))
        self._rows = read_only(np.vstack([np.eye(joints), -np.eye(joints)]))
        self._angles, self._last_velocity = np.zeros(2 * joints), np.zeros(2 * joints)
        self._bounds: list[tuple[str, Array]] = []
        self._set_period(0.0)

    def reasons(self) -> list[str]:
        """Name for each row of the last step the joint and which of its limits is the narrowest; empty before the first."""
        if not self._bounds:
            return []
        names = [name for name, _ in self._bounds]
        narrowest = np.argmin([bound for _, bound in self._bounds], axis=0)
        return [f"{names[which]} of joint {row % self._joints + 1}" for row, which in enumerate(narrowest)]

    def set_last_velocity(self, velocity: Array) -> None:
        """Tell the joint velocity of the last step, (nv,), rad/s."""
        self._both_ways(velocity, self._last_velocity)

    def compute_qp_inequalities(self, configuration: Configuration, dt: float) -> tuple[Array, Array]:
        """Return G (2 nv, nv) and h (2 nv,) of `G dq <= h`."""
        self._both_ways(configuration.q, self._angles)
        left = self._limits - self._angles
        np.maximum(left, 0.0, out=left)
        if dt != self._period:
            self._set_period(dt)
        position, speed = _POSITION_GAIN * left, self._speed
        bound = np.minimum(position, speed)
        self._bounds = [("position", position), ("speed", speed)]
        if self._max_acceleration is not None:
            gathering = dt * (self._last_velocity + self._change)
            braking = dt * np.sqrt(self._twice * left)
            np.minimum(bound, gathering, out=bound)
            np.minimum(bound, braking, out=bound)
            self._bounds += [("acceleration", gathering), ("position", braking)]
        return self._rows, bound

    def _set_period(self, dt: float) -> None:
        """Work out what depends on the length of a step alone."""
        self._period, self._speed = dt, dt * self._max_speed
        if self._max_acceleration is not None:
            self._change, self._twice = dt * self._max_acceleration, 2.0 * self._max_acceleration

    def _both_ways(self, values: Array, out: Array) -> None:
        """Write values (nv,) as they count towards the upper limits, then towards the lower ones."""
        out[: self._joints] = values
        np.negative(values, out=out[self._joints :])
