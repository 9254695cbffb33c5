"""Which points of the tissue the tool hides from the camera or keeps from the projector's light."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from laploop.assets.shafts import INSTRUMENT, Shaft
from laploop.control.vectors import length
from laploop.errors import InvalidValueError

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class ToolOutline:
    """The instrument's silhouette as a capsule that tapers to its ball end."""

    shaft: Shaft = INSTRUMENT
    neck_m: float = 0.010
    """From the ball's centre, the length that is as thin as the ball."""
    taper_m: float = 0.014
    """After the neck, the length over which the radius grows to the shaft's."""
    margin_m: float = 0.0012
    """Added to the radius: the width of an estimator's transition from tool to tissue, about three pixels at 85 mm."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a length is negative, or the taper's not above 0.
        """
        for name in ("neck_m", "margin_m"):
            if getattr(self, name) < 0.0:
                raise InvalidValueError(name, getattr(self, name), "0 or more")
        if not self.taper_m > 0.0:
            raise InvalidValueError("taper_m", self.taper_m, "above 0")

    def radius(self, distance_from_tip: Array) -> Array:
        """Return the radius with its margin, (n,), at distances (n,) from the ball's centre along the shaft."""
        wide, thin = 0.5 * self.shaft.diameter_m, self.shaft.tip_radius_m
        slope = (wide - thin) / self.taper_m
        radius: Array = slope * _clamp(distance_from_tip - self.neck_m, self.taper_m) + (thin + self.margin_m)
        return radius


def hidden_by_tool(points: Array, tip: Array, trocar: Array, eyes: Array, outline: ToolOutline) -> BoolArray:
    """Say for which points the tool comes close to the line of sight from any of the eyes.

    For each pair of a line of sight `e + s (p - e)` and the tool's axis `tip + t (trocar - tip)`, both with parameters from
    0 to 1, the nearest pair of points is found in closed form; the sight is blocked where their distance is less than the
    tool's radius there.

    Args:
        points: (n, 3), points of the surface.
        tip: (3,), centre of the tool's ball end.
        trocar: (3,), where the shaft comes from.
        eyes: (k, 3), the camera's and the projector's centre, say.
        outline: The tool's radius along its axis.

    Returns:
        (n,), True where at least one line of sight is blocked. All points are given in one frame.
    """
    axis = trocar - tip
    reach = length(axis)
    axis /= reach
    start = eyes - tip
    sight = points.T - eyes[:, :, None]
    # With the axis scaled to length 1, t is a length along it; a, b, c and f are the products that the distance is made of.
    a = np.add.reduce(sight * sight, axis=1)
    b = axis @ sight
    c = (start[:, None] @ sight)[:, 0]
    f = (start @ axis)[:, None]
    # Ericson, Real-Time Collision Detection, 5.1.9: the unclamped optimum first, then each parameter given the other.
    s = _clamp((b * f - c) / np.maximum(a - b * b, 1e-15 * a), 1.0)
    t = _clamp(b * s + f, reach)
    s = _clamp((b * t - c) / a, 1.0)
    apart = s * (s * a + 2.0 * (c - b * t)) + t * (t - 2.0 * f) + np.add.reduce(start * start, axis=1)[:, None]
    radius = outline.radius(t)
    return np.asarray(np.logical_or.reduce(apart < radius * radius))


def _clamp(values: Array, highest: float) -> Array:
    """Bring values to the range from 0 to a number, in place: numpy's own function takes longer for so few."""
    np.maximum(values, 0.0, out=values)
    return np.minimum(values, highest, out=values)
