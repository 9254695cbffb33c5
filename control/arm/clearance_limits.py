"""Limits of Pink that keep a shaft off another shaft and off the wall around its trocar.

A distance d with gradient g (by the joint angles) must stay above d_min: one row `-g dq <= gain (d - d_min)`, so that a step
uses a fraction of the clearance that is left, and the arm comes to rest at the bound. Below the bound it only forbids going
on: standing still stays allowed, and the problem solvable. Far from the bound there is no row at all, and the problem is to
the bit the one without the limit.
"""

import math
from collections.abc import Iterator

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from pink import Configuration

from laploop.arrays import Array
from laploop.control.arm.model import SHAFT_TIP, checked_vector
from laploop.control.arm.named_limit import NamedLimit
from laploop.errors import InvalidValueError

GAIN = 0.1
"""Fraction of the clearance left that one step may use: 12.5 per second at 125 Hz, gentle enough for the joints."""

_WATCHED_M = 0.03
"""Clearance below which a limit has its row. No point of a shaft moves by a tenth of that in a step."""


class ShaftClearanceLimit(NamedLimit):
    """Keep this shaft, a capsule, away from another one."""

    def __init__(self, *, length_m: float, radius_m: float, min_clearance_m: float) -> None:
        """Take this shaft's length from tip to flange, its radius, and the clearance to keep between the surfaces."""
        self._length, self._radius, self._min_clearance = length_m, radius_m, min_clearance_m
        self._other: tuple[Array, Array, float] | None = None

    def set_other(self, tip_in_world: ArrayLike, flange_in_world: ArrayLike, radius_m: float) -> None:
        """Place the other shaft: its ends, each (3,), and its radius.

        Raises:
            InvalidValueError: If an end is not three finite numbers or the radius is negative.
        """
        if not 0.0 <= radius_m < math.inf:
            raise InvalidValueError("radius_m", radius_m, "finite, 0 or more")
        tip = checked_vector("tip_in_world", tip_in_world, 3)
        flange = checked_vector("flange_in_world", flange_in_world, 3)
        self._other = tip, flange, radius_m

    def clear_other(self) -> None:
        """Forget the other shaft."""
        self._other = None

    def clearance(self, configuration: Configuration) -> float:
        """Return the distance between the surfaces in metres; infinite without another shaft."""
        return math.inf if self._other is None else self._nearest(configuration, *self._other)[0]

    def compute_qp_inequalities(self, configuration: Configuration, dt: float) -> tuple[Array, Array] | None:  # noqa: ARG002
        """Return G (1, nv) and h (1,) of `G dq <= h`, or None far from the other shaft."""
        if self._other is None:
            return None
        clearance, along, outwards = self._nearest(configuration, *self._other)
        left = clearance - self._min_clearance
        if left > _WATCHED_M:
            return None
        gradient = _velocity_gradient(configuration, along, outwards)
        return -gradient[None, :], np.array([max(GAIN * left, 0.0)])

    def row_names(self, configuration: Configuration, dt: float) -> list[str]:
        """Name the other shaft where it is near."""
        return [] if self.compute_qp_inequalities(configuration, dt) is None else ["the other shaft"]

    def _nearest(
        self, configuration: Configuration, other_tip: Array, other_flange: Array, other_radius: float
    ) -> tuple[float, float, Array]:
        """Return the clearance, the distance from this tip at which it is least, and the unit way out, (3,)."""
        pose = configuration.get_transform_frame_to_world(SHAFT_TIP)
        tip = pose.translation
        flange = tip - self._length * pose.rotation[:, 2]
        s, t = nearest_parameters(tip, flange, other_tip, other_flange)
        apart = tip + s * (flange - tip) - other_tip - t * (other_flange - other_tip)
        distance = float(np.linalg.norm(apart))
        # Axes that cross have no direction of their own: any way across both is one.
        outwards = apart / distance if distance > 1e-9 else _across(flange - tip, other_flange - other_tip)
        return distance - other_radius - self._radius, s * self._length, outwards


class WallLimit(NamedLimit):
    """Keep the tip on the inner side of the wall and the flange, with what it holds, on the outer."""

    def __init__(
        self,
        trocar_in_world: ArrayLike,
        outwards: ArrayLike,
        *,
        length_m: float,
        min_tip_depth_m: float,
        min_flange_height_m: float,
    ) -> None:
        """Take the wall's plane and the least distances from it.

        Args:
            trocar_in_world: (3,), a point of the wall.
            outwards: (3,), the wall's normal, out of the patient.
            length_m: Of the shaft, from flange to tip.
            min_tip_depth_m: Least depth of the tip below the wall.
            min_flange_height_m: Least height of the flange above it.

        Raises:
            InvalidValueError: If a vector is not three finite numbers or the normal is zero.
        """
        normal = checked_vector("outwards", outwards, 3)
        size = float(np.linalg.norm(normal))
        if size < 1e-9:
            raise InvalidValueError("outwards", normal.tolist(), "a vector that is not zero")
        self._outwards: Array = normal / size
        self._height = float(self._outwards @ checked_vector("trocar_in_world", trocar_in_world, 3))
        self._length, self._min_tip_depth, self._min_flange_height = length_m, min_tip_depth_m, min_flange_height_m

    def compute_qp_inequalities(self, configuration: Configuration, dt: float) -> tuple[Array, Array] | None:  # noqa: ARG002
        """Return G (n, nv) and h (n,) of `G dq <= h` with a row for each end that is near the wall, or None."""
        rows = [
            (-_velocity_gradient(configuration, along, way), max(GAIN * left, 0.0))
            for _, along, way, left in self._near_ends(configuration)
        ]
        if not rows:
            return None
        gradients, bounds = zip(*rows, strict=True)
        return np.array(gradients), np.array(bounds)

    def row_names(self, configuration: Configuration, dt: float) -> list[str]:  # noqa: ARG002
        """Name the ends that are near the wall."""
        return [f"the wall, at the {end}" for end, _, _, _ in self._near_ends(configuration)]

    def _near_ends(self, configuration: Configuration) -> Iterator[tuple[str, float, Array, float]]:
        """Yield name, distance from the tip, direction away from the wall, (3,), and clearance left of each near end."""
        pose = configuration.get_transform_frame_to_world(SHAFT_TIP)
        tip_height = float(self._outwards @ pose.translation) - self._height
        flange_height = tip_height - self._length * float(self._outwards @ pose.rotation[:, 2])
        left = -tip_height - self._min_tip_depth
        if left <= _WATCHED_M:
            yield "tip", 0.0, -self._outwards, left
        left = flange_height - self._min_flange_height
        if left <= _WATCHED_M:
            yield "flange", self._length, self._outwards, left


def nearest_parameters(a: ArrayLike, b: ArrayLike, c: ArrayLike, d: ArrayLike) -> tuple[float, float]:
    """Return s and t from 0 to 1 for which `a + s (b - a)` and `c + t (d - c)` are nearest to each other.

    Closed form of Ericson, Real-Time Collision Detection, 5.1.9; points are (3,), the segments must not be points.
    """
    u, v, w = np.subtract(b, a), np.subtract(d, c), np.subtract(a, c)
    uu, vv, uv, uw, vw = (float(x @ y) for x, y in ((u, u), (v, v), (u, v), (u, w), (v, w)))
    denominator = uu * vv - uv * uv
    s = min(max((uv * vw - uw * vv) / denominator, 0.0), 1.0) if denominator > 1e-12 * uu * vv else 0.0
    t = (uv * s + vw) / vv
    if t < 0.0:
        return min(max(-uw / uu, 0.0), 1.0), 0.0
    if t > 1.0:
        return min(max((uv - uw) / uu, 0.0), 1.0), 1.0
    return s, t


def _velocity_gradient(configuration: Configuration, along: float, direction: Array) -> Array:
    """Return the derivative (nv,) of the way in a direction, (3,), of the shaft's point at a distance from its tip."""
    jacobian = configuration.get_frame_jacobian(SHAFT_TIP)
    rotation = configuration.get_transform_frame_to_world(SHAFT_TIP).rotation
    moved = jacobian[:3] - pin.skew(np.array([0.0, 0.0, -along])) @ jacobian[3:]
    return np.asarray((rotation.T @ direction) @ moved)


def _across(u: Array, v: Array) -> Array:
    """Return a unit vector (3,) across two others, also where they are parallel."""
    normal = np.cross(u, v)
    size = float(np.linalg.norm(normal))
    if size < 1e-12 * float(np.linalg.norm(u)) * float(np.linalg.norm(v)):
        normal = np.cross(u, np.eye(3)[int(np.argmin(np.abs(u)))])
        size = float(np.linalg.norm(normal))
    return np.asarray(normal / size)
