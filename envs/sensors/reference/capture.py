"""A capture of the reference camera."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True, eq=False)
class ReferenceCapture:
    """A point cloud in image order, with the names and units of the camera's own software.

    All floating-point arrays are NaN at the same pixels: where there is no point.
    """

    xyz: NDArray[np.float32]
    """(height, width, 3), millimetres, in the frame of the camera: x right, y down, z forward."""
    z: NDArray[np.float32]
    """(height, width), millimetres; the same as `xyz[..., 2]`."""
    rgba: NDArray[np.uint8]
    """(height, width, 4), the colour picture under the projector's white light, sRGB; its alpha is 255 everywhere."""
    normals: NDArray[np.float32]
    """(height, width, 3), unit vectors towards the camera."""
    snr: NDArray[np.float32]
    """(height, width), signal-to-noise ratio."""

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(height, width), where there is a point."""
        return np.isfinite(self.z)
