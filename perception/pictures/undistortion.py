"""Images of a distorted lens as a pinhole camera of the same intrinsics would see them."""

import cv2
import numpy as np
from numpy.typing import NDArray

from laploop.perception.calibration.results import CameraCalibration
from laploop.perception.reprojection import BrownDistortion


class Undistortion:
    """Resamples images of a calibrated camera, cubically; those of a lens without distortion stay as they are, to the bit."""

    def __init__(self, camera: CameraCalibration) -> None:
        """Work out where each pixel of the pinhole image lies in the camera's own."""
        k, distortion = camera.intrinsics, camera.distortion
        self.seen: NDArray[np.bool_] = np.ones((k.height, k.width), dtype=bool)
        """(height, width), pixels of the pinhole image that the camera's own reaches."""
        self._map: tuple[NDArray[np.float32], NDArray[np.float32]] | None = None
        if distortion == BrownDistortion():
            return
        x, y = k.rays[..., 0], k.rays[..., 1]
        on_lens_x, on_lens_y = distortion.apply(x, y)
        u, v = k.fx * on_lens_x + k.cx, k.fy * on_lens_y + k.cy
        self.seen = (u >= 0.0) & (v >= 0.0) & (u <= k.width) & (v <= k.height)
        # Beyond the radius where the polynomial folds back, it would show a place twice.
        self.seen &= x * x + y * y < distortion.largest_radius_tan**2
        # OpenCV puts the centre of the first pixel at (0, 0).
        self._map = (u - 0.5).astype(np.float32), (v - 0.5).astype(np.float32)

    def apply(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the pinhole image (height, width); black where the camera does not reach."""
        if self._map is None:
            return image
        resampled = cv2.remap(image, *self._map, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        return np.where(self.seen, resampled, 0).astype(np.uint8)
