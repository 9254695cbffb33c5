"""The bounds of one step of every joint, gathered into one box."""

import numpy as np
from numpy.typing import NDArray
from pink import Configuration
from pink.limits import Limit

from laploop.control.robot import read_only

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
        self._lower, self._upper = read_only(lower), read_only(upper)
        # Twice: towards the upper limits, then towards the lower ones.
        self._max_speed = read_only(np.tile(max_speed, 2))
        self._max_acceleration = None if max_acceleration is None else read_only(np.tile(max_acceleration, 2))
        self._rows = read_only(np.vstack([np.eye(len(lower)), -np.eye(len(lower))]))
        self._last_velocity = np.zeros(2 * len(lower))
        self._left = np.zeros(2 * len(lower))
        self._bounds: list[tuple[str, Array]] = []

    def reasons(self) -> list[str]:
        """Name for each row of the last step the joint and which of its limits is the narrowest; empty before the first."""
        if not self._bounds:
            return []
        names = [name for name, _ in self._bounds]
        narrowest = np.argmin([bound for _, bound in self._bounds], axis=0)
        joints = len(self._lower)
        return [f"{names[which]} of joint {row % joints + 1}" for row, which in enumerate(narrowest)]

    def set_last_velocity(self, velocity: Array) -> None:
        """Tell the joint velocity of the last step, (nv,), rad/s."""
        joints = len(self._lower)
        self._last_velocity[:joints] = velocity
        self._last_velocity[joints:] = -velocity

    def compute_qp_inequalities(self, configuration: Configuration, dt: float) -> tuple[Array, Array]:
        """Return G (2 nv, nv) and h (2 nv,) of `G dq <= h`."""
        joints, left = len(self._lower), self._left
        left[:joints] = self._upper - configuration.q
        left[joints:] = configuration.q - self._lower
        np.maximum(left, 0.0, out=left)
        position, speed = _POSITION_GAIN * left, dt * self._max_speed
        bound = np.minimum(position, speed)
        self._bounds = [("position", position), ("speed", speed)]
        if self._max_acceleration is not None:
            acceleration = self._max_acceleration
            gathering = dt * (self._last_velocity + dt * acceleration)
            braking = dt * np.sqrt(2.0 * acceleration * left)
            bound = np.minimum(np.minimum(bound, gathering), braking)
            self._bounds += [("acceleration", gathering), ("position", braking)]
        return self._rows, bound
