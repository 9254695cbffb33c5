"""Which points of the tissue the tool hides from the camera or keeps from the projector's light."""

from collections import deque
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from laploop.arrays import Array
from laploop.assets.shafts import INSTRUMENT, Shaft
from laploop.configuration import Field, configuration

BoolArray = NDArray[np.bool_]

_HISTORY_TICKS = 128
"""Remembered positions of the tool: one second at 125 Hz, more than the age of any frame worth using."""


@configuration
class ToolOutline:
    """The instrument's silhouette as a capsule that tapers to its ball end."""

    shaft: Shaft = INSTRUMENT
    """The instrument."""
    neck_m: Annotated[float, Field(ge=0.0, le=0.5)] = 0.010
    """Length, from the ball's centre, that is as thin as the ball."""
    taper_m: Annotated[float, Field(gt=0.0, le=0.5)] = 0.014
    """Length after the neck over which the radius grows to the shaft's."""
    margin_m: Annotated[float, Field(ge=0.0, le=0.05)] = 0.0012
    """Added to the radius: the width of an estimator's transition from tool to tissue, about three pixels at 85 mm."""

    def radius(self, distance_from_tip: Array) -> Array:
        """Return the radius with its margin, (n,), at distances (n,) from the ball's centre along the shaft."""
        wide, thin = 0.5 * self.shaft.diameter_m, self.shaft.tip_radius_m
        slope = (wide - thin) / self.taper_m
        return np.asarray(slope * np.clip(distance_from_tip - self.neck_m, 0.0, self.taper_m) + (thin + self.margin_m))


class ToolOcclusion:
    """Remembers where the tool's tip was, and so what it hid in frames that arrive late."""

    def __init__(self, outline: ToolOutline, eyes: Array) -> None:
        """Take the tool's outline and the points to which tissue must be open, (k, 3): camera and projector."""
        self._outline = outline
        self._eyes = eyes
        self._tips: deque[tuple[int, Array]] = deque(maxlen=_HISTORY_TICKS)

    def reset(self) -> None:
        """Forget where the tool was."""
        self._tips.clear()

    def add(self, now_ns: int, tip: Array) -> None:
        """Take in where the tip is, (3,); ignored unless finite."""
        if np.isfinite(tip).all():
            self._tips.append((now_ns, tip))

    def hidden(self, points: Array, captured_ns: int, trocar: Array) -> BoolArray:
        """Return which points (n, 3) the tool hid at the time of a capture; none before its tip has been known."""
        if not self._tips:
            return np.zeros(len(points), dtype=bool)
        # The newest position that is not later, else the oldest that is known.
        before = (tip for time_ns, tip in reversed(self._tips) if time_ns <= captured_ns)
        return hidden_by_tool(points, next(before, self._tips[0][1]), trocar, self._eyes, self._outline)


def hidden_by_tool(points: Array, tip: Array, trocar: Array, eyes: Array, outline: ToolOutline) -> BoolArray:
    """Return for which points the tool comes close to the line of sight from any of the eyes.

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
    reach = float(np.linalg.norm(trocar - tip))
    axis = (trocar - tip) / reach
    start = (eyes - tip)[:, None]
    sight = points - eyes[:, None]
    # With the axis scaled to length 1, t is a length along it; a, b, c and f are the products that the distance is made of.
    a, b = (sight * sight).sum(axis=-1), sight @ axis
    c, f = (start * sight).sum(axis=-1), start @ axis
    # Ericson, Real-Time Collision Detection, 5.1.9: the unclamped optimum first, then each parameter given the other.
    s = np.clip((b * f - c) / np.maximum(a - b * b, 1e-15 * a), 0.0, 1.0)
    t = np.clip(b * s + f, 0.0, reach)
    s = np.clip((b * t - c) / a, 0.0, 1.0)
    apart = np.linalg.norm(start + s[..., None] * sight - t[..., None] * axis, axis=-1)
    return np.asarray((apart < outline.radius(t)).any(axis=0))
