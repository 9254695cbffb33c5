"""A path drawn in an image, laid onto the surface."""

import numpy as np

from laploop.arrays import Array
from laploop.control.controllers.approach_geometry import unit
from laploop.control.targeting.surface_patch import SurfacePatch
from laploop.errors import InvalidValueError

_SMOOTHING_M = 0.002
"""Standard deviation of the window along the path over which normals are averaged; less than the bends of bowel."""

_EXPECTED_SPREAD_M = 1e-4
"""Spread of points from a good fit; a place with a larger one counts less than its neighbours."""

_END_M = 0.006
"""Length of the end of the path whose direction continues it."""


class ScanPath:
    """Points and normals along a line on the surface, by arc length, in the frame of the camera that saw them.

    Each place is a robust fit of its own. Normals are averaged along the path, those of bad fits counting less: where depth
    is bent away from the surface, it is also rough.
    """

    def __init__(self, patches: list[SurfacePatch]) -> None:
        """Take the surface at the places of the path, in order.

        Raises:
            InvalidValueError: If there are fewer than two places.
        """
        if len(patches) < 2:
            raise InvalidValueError("places of the path on the surface", len(patches), "2 or more")
        self._points = np.array([patch.point for patch in patches])
        normals = np.array([patch.normal for patch in patches])
        spreads = np.array([patch.spread_m for patch in patches])
        steps = np.linalg.norm(np.diff(self._points, axis=0), axis=1)
        self._along = np.concatenate([[0.0], np.cumsum(np.maximum(steps, 1e-6))])
        apart = (self._along[:, None] - self._along) / _SMOOTHING_M
        weights = np.exp(-0.5 * apart**2) / (spreads**2 + _EXPECTED_SPREAD_M**2)
        self._normals = (weights @ normals) / weights.sum(axis=1, keepdims=True)

    @property
    def length_m(self) -> float:
        """Length of the path on the surface."""
        return float(self._along[-1])

    def place(self, along_m: float) -> tuple[Array, Array]:
        """Return point and unit normal, each (3,), at an arc length; beyond an end, straight on along the surface there."""
        point = np.array([np.interp(along_m, self._along, self._points[:, axis]) for axis in range(3)])
        normal = np.array([np.interp(along_m, self._along, self._normals[:, axis]) for axis in range(3)])
        normal = unit(normal)
        beyond = max(along_m - self.length_m, 0.0) + min(along_m, 0.0)
        if beyond != 0.0:
            within = min(_END_M, self.length_m)
            inner = self.length_m - within if beyond > 0.0 else within
            chord = np.sign(beyond) * (point - self.place(inner)[0])
            point = point + beyond * unit(chord - (chord @ normal) * normal)
        return point, normal

    def above(self, along_m: float, height_m: float) -> Array:
        """Return the point (3,) at a height over the path along its normal."""
        point, normal = self.place(along_m)
        return point + height_m * normal
