"""What keeps a shaft off another shaft and off the wall around its trocar, as Pink knows limits.

A distance d with gradient g (by the joint angles) must stay above d_min: one row `-g dq <= gain (d - d_min)`, so that a step
uses a share of the room that is left, and the arm comes to rest at the bound. Below the bound it only forbids going on:
standing still stays allowed, and the problem solvable. Far from the bound there is no row at all, and the problem is to the
bit the one without the limit.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pink import Configuration
from pink.limits import Limit

from laploop.control.arm.model import SHAFT_TIP, checked_vector
from laploop.control.arm.rcm_task import moment, pose_rows, world_from_shaft
from laploop.errors import InvalidValueError

Array = NDArray[np.float64]
Point = Sequence[float]
"""A point or a direction, (3,), as plain numbers: quicker than an array where they are taken one by one."""

GAIN = 0.1
"""Share of the room left that one step may use: 12.5 per second at 125 Hz, gentle enough for the joints' acceleration."""

_WATCHED_M = 0.03
"""Room from which on a limit has its row. No point of a shaft moves by a tenth of that in a step."""


class ShaftClearanceLimit(Limit):
    """Keep the own shaft, a capsule, away from another one that is told to it."""

    def __init__(self, *, length_m: float, radius_m: float, margin_m: float) -> None:
        """Take the own shaft's length from tip to flange and its radius, and the room to keep between the surfaces."""
        self._length, self._radius, self._margin = length_m, radius_m, margin_m
        self._other: tuple[Point, Point, float] | None = None
        self.reasons: Sequence[str] = ()
        """Of each row of the last step."""

    def set_other(self, tip_in_world: ArrayLike, flange_in_world: ArrayLike, radius_m: float) -> None:
        """Tell where the other shaft is: its ends, each (3,), and its radius.

        Raises:
            InvalidValueError: If an end is not three finite numbers or the radius is negative.
        """
        if not 0.0 <= radius_m < math.inf:
            raise InvalidValueError("radius_m", radius_m, "finite, 0 or more")
        ends = (("tip_in_world", tip_in_world), ("flange_in_world", flange_in_world))
        tip, flange = (checked_vector(name, end, 3).tolist() for name, end in ends)
        self._other = tip, flange, radius_m

    def clear_other(self) -> None:
        """Forget the other shaft."""
        self._other = None

    def distance(self, configuration: Configuration) -> float:
        """Return the room between the surfaces in metres; infinite without another shaft."""
        if self._other is None:
            return math.inf
        return self._nearest(configuration, *self._other)[0]

    def compute_qp_inequalities(self, configuration: Configuration, dt: float) -> tuple[Array, Array] | None:  # noqa: ARG002
        """Return G (1, nv) and h (1,) of `G dq <= h`, or None far from the other shaft."""
        self.reasons = ()
        if self._other is None:
            return None
        distance, along, direction = self._nearest(configuration, *self._other)
        room = distance - self._margin
        if room > _WATCHED_M:
            return None
        self.reasons = ("the other shaft",)
        jacobian = configuration.get_frame_jacobian(SHAFT_TIP)
        moved = jacobian[:3] - moment(np.array([0.0, 0.0, -along])) @ jacobian[3:]
        gradient = (world_from_shaft(configuration)[:3, :3].T.copy() @ direction) @ moved
        return -gradient[None, :], np.array([max(GAIN * room, 0.0)])

    def _nearest(self, configuration: Configuration, end: Point, other_end: Point, radius: float) -> tuple[float, float, Point]:
        """Return the room between the surfaces, how far from the own tip it is least, and the unit way out, (3,)."""
        (_, _, a, x), (_, _, b, y), (_, _, c, z), _ = pose_rows(configuration)
        tip, flange = (x, y, z), (x - self._length * a, y - self._length * b, z - self._length * c)
        s, t = nearest_parameters(tip, flange, end, other_end)
        own, other = _difference(flange, tip), _difference(other_end, end)
        apart = [p + s * u - q - t * v for p, u, q, v in zip(tip, own, end, other, strict=True)]
        distance = math.sqrt(_dot(apart, apart))
        # Axes that cross have no direction of their own: any way across both is one.
        direction = [way / distance for way in apart] if distance > 1e-9 else _across(own, other)
        return distance - radius - self._radius, s * self._length, direction


class WallLimit(Limit):
    """Keep the tip on the inner side of the wall and the flange, with what it holds, on the outer."""

    def __init__(
        self,
        trocar_in_world: ArrayLike,
        outwards: ArrayLike,
        *,
        length_m: float,
        tip_room_m: float,
        flange_room_m: float,
    ) -> None:
        """Take the wall's plane and the least distances from it.

        Args:
            trocar_in_world: (3,), a point of the wall.
            outwards: (3,), the wall's normal, out of the patient.
            length_m: Of the shaft, from flange to tip.
            tip_room_m: Least depth of the tip below the wall.
            flange_room_m: Least height of the flange above it.

        Raises:
            InvalidValueError: If a vector is not three finite numbers or the normal is zero.
        """
        normal = checked_vector("outwards", outwards, 3)
        size = float(np.linalg.norm(normal))
        if size < 1e-9:
            raise InvalidValueError("outwards", normal.tolist(), "a vector that is not zero")
        self._outwards: Point = (normal / size).tolist()
        self._height = _dot(self._outwards, checked_vector("trocar_in_world", trocar_in_world, 3).tolist())
        self._length, self._tip_room, self._flange_room = length_m, tip_room_m, flange_room_m
        self.reasons: Sequence[str] = ()
        """Of each row of the last step."""

    def compute_qp_inequalities(self, configuration: Configuration, dt: float) -> tuple[Array, Array] | None:  # noqa: ARG002
        """Return G (n, nv) and h (n,) of `G dq <= h` with a row for each end that is near the wall, or None."""
        (_, _, a, x), (_, _, b, y), (_, _, c, z), _ = pose_rows(configuration)
        above = _dot(self._outwards, (x, y, z)) - self._height
        lean = _dot(self._outwards, (a, b, c))
        tip_room = -above - self._tip_room
        flange_room = above - self._length * lean - self._flange_room
        self.reasons = ()
        if min(tip_room, flange_room) > _WATCHED_M:
            return None
        jacobian = configuration.get_frame_jacobian(SHAFT_TIP)
        normal = world_from_shaft(configuration)[:3, :3].T.copy() @ self._outwards
        rows, bounds, reasons = [], [], []
        if tip_room <= _WATCHED_M:
            rows.append(normal @ jacobian[:3])
            bounds.append(max(GAIN * tip_room, 0.0))
            reasons.append("the wall, at the tip")
        if flange_room <= _WATCHED_M:
            moved = jacobian[:3] - moment(np.array([0.0, 0.0, -self._length])) @ jacobian[3:]
            rows.append(-(normal @ moved))
            bounds.append(max(GAIN * flange_room, 0.0))
            reasons.append("the wall, at the flange")
        self.reasons = tuple(reasons)
        return np.array(rows), np.array(bounds)


def nearest_parameters(a: Point, b: Point, c: Point, d: Point) -> tuple[float, float]:
    """Return s and t from 0 to 1 for which `a + s (b - a)` and `c + t (d - c)` are nearest to each other.

    Closed form of Ericson, Real-Time Collision Detection, 5.1.9; the segments must not be points.
    """
    u, v, w = _difference(b, a), _difference(d, c), _difference(a, c)
    uu, vv, uv, uw, vw = _dot(u, u), _dot(v, v), _dot(u, v), _dot(u, w), _dot(v, w)
    denominator = uu * vv - uv * uv
    s = min(max((uv * vw - uw * vv) / denominator, 0.0), 1.0) if denominator > 1e-12 * uu * vv else 0.0
    t = (uv * s + vw) / vv
    if t < 0.0:
        return min(max(-uw / uu, 0.0), 1.0), 0.0
    if t > 1.0:
        return min(max((uv - uw) / uu, 0.0), 1.0), 1.0
    return s, t


def _difference(u: Point, v: Point) -> Point:
    """Subtract three numbers from three: numpy takes several times as long for so few."""
    return (u[0] - v[0], u[1] - v[1], u[2] - v[2])


def _dot(u: Point, v: Point) -> float:
    """Multiply three numbers with three."""
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


def _across(u: Point, v: Point) -> Point:
    normal = np.cross(u, v)
    size = float(np.linalg.norm(normal))
    if size < 1e-12 * float(np.linalg.norm(u)) * float(np.linalg.norm(v)):
        normal = np.cross(u, np.eye(3)[int(np.argmin(np.abs(u)))])
        size = float(np.linalg.norm(normal))
    return tuple((normal / size).tolist())
