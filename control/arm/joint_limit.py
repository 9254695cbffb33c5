"""Position, speed and acceleration limits of all joints in one box."""

import numpy as np
from pink import Configuration

from laploop.arrays import Array
from laploop.control.arm.model import read_only
from laploop.control.arm.named_limit import NamedLimit

_POSITION_GAIN = 0.5
"""Fraction of the way to a position limit that one step may use."""


class JointBoxLimit(NamedLimit):
    """Position, speed and acceleration limits of all joints as one pair of bounds a joint.

    With the last velocity v and the way r left to a position limit, a step of length h may go towards that limit by at most

        min(v_max h, r / 2, (v + a_max h) h, sqrt(2 a_max r) h);

    the last term is the speed from which the joint can still brake (Flacco, De Luca and Khatib, IEEE Trans Robot 2015;31:637).
    Pink's own limits say the same in three times as many rows, but its acceleration limit gives NaN beyond a position limit.
    """

    def __init__(self, lower: Array, upper: Array, max_speed: Array, max_acceleration: Array | None = None) -> None:
        """Take the limits of all joints, each (nv,), in rad, rad/s and rad/s^2; accelerations are unlimited by default."""
        joints = len(lower)
        self._lower, self._upper = read_only(lower), read_only(upper)
        self._max_speed = read_only(np.tile(max_speed, 2))
        self._max_acceleration = None if max_acceleration is None else read_only(np.tile(max_acceleration, 2))
        self._rows = read_only(np.vstack([np.eye(joints), -np.eye(joints)]))
        self._last_velocity = np.zeros(2 * joints)

    def set_last_velocity(self, velocity: Array) -> None:
        """Set the joint velocity of the last step, (nv,), rad/s."""
        self._last_velocity = np.concatenate([velocity, -velocity])

    def compute_qp_inequalities(self, configuration: Configuration, dt: float) -> tuple[Array, Array]:
        """Return G (2 nv, nv) and h (2 nv,) of `G dq <= h`: towards the upper limits, then towards the lower ones."""
        return self._rows, np.min([bound for _, bound in self._bounds(configuration, dt)], axis=0)

    def row_names(self, configuration: Configuration, dt: float) -> list[str]:
        """Name for each row the joint and whichever of its limits is the narrowest."""
        names, bounds = zip(*self._bounds(configuration, dt), strict=True)
        joints = len(self._lower)
        return [f"{names[which]} of joint {row % joints + 1}" for row, which in enumerate(np.argmin(bounds, axis=0))]

    def _bounds(self, configuration: Configuration, dt: float) -> list[tuple[str, Array]]:
        q = configuration.q
        left = np.maximum(np.concatenate([self._upper - q, q - self._lower]), 0.0)
        bounds = [("position", _POSITION_GAIN * left), ("speed", dt * self._max_speed)]
        if self._max_acceleration is not None:
            bounds.append(("acceleration", dt * (self._last_velocity + dt * self._max_acceleration)))
            bounds.append(("position", dt * np.sqrt(2.0 * self._max_acceleration * left)))
        return bounds
