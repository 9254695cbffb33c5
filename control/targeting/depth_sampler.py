"""What a depth frame shows where points appear in it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from laploop.perception.geometry import Rig
from laploop.perception.messages import DepthFrame

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Places:
    """Where n points appear between the centres of pixels; the same for every frame."""

    neighbours: NDArray[np.intp]
    """(4, n), the pixels around each: upper left, lower left, upper right, lower right, counted along the rows."""
    right: Array
    """(n,), from the left ones to the right ones, 0 to 1."""
    down: Array
    """(n,), from the upper ones to the lower ones."""
    inside: NDArray[np.bool_]
    """(n,), whether all four lie in the frame."""


class DepthSampler:
    """Reads depth between the centres of pixels, bilinearly; all four neighbours must be valid."""

    def __init__(self, rig: Rig) -> None:
        """Take the camera's geometry."""
        camera = rig.camera
        self._width = camera.width
        self._focal = np.array([[camera.fx], [camera.fy]])
        self._first_centre = np.array([[camera.cx - 0.5], [camera.cy - 0.5]])
        self._last_corner = np.array([[camera.width - 1.0], [camera.height - 1.0]])
        self._around = np.array([[0], [camera.width], [1], [camera.width + 1]])

    def places(self, points: Array) -> Places:
        """Return where points (3, n) of the camera's frame appear."""
        pixels = self._focal * points[:2] / points[2] + self._first_centre
        inside = np.logical_and.reduce((pixels >= 0.0) & (pixels < self._last_corner))
        corner = np.floor(pixels)
        right, down = pixels - corner
        first = corner[1] * self._width + corner[0]
        return Places(neighbours=first.astype(np.intp) + self._around, right=right, down=down, inside=inside)

    @staticmethod
    def sample(frame: DepthFrame, places: Places) -> tuple[Array, NDArray[np.bool_]]:
        """Return the depth in metres, (n,), that a frame shows at places, and where that is known."""
        # What lies outside of the frame may be read anywhere: it does not count.
        depth_m = np.multiply(frame.estimate.depth_mm.take(places.neighbours, mode="clip"), 1e-3, dtype=np.float64)
        known = np.isfinite(depth_m) & frame.estimate.valid.take(places.neighbours, mode="clip")
        depth_m = np.where(known, depth_m, 0.0)
        # Upper and lower row of the four at once.
        upper, lower = depth_m[:2] + places.right * (depth_m[2:] - depth_m[:2])
        return upper + places.down * (lower - upper), places.inside & np.logical_and.reduce(known)
