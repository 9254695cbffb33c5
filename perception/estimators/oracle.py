"""Exact depth, as a yardstick for everything downstream of perception."""

import numpy as np
from numpy.typing import NDArray

from laploop.errors import InvalidValueError
from laploop.perception.estimators.base import check_image
from laploop.perception.geometry import Rig
from laploop.perception.messages import DepthEstimate


class OracleEstimator:
    """Returns the exact depth that the environment showed it beforehand."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._truth: NDArray[np.float32] | None = None

    def see_truth(self, depth_mm: NDArray[np.float32]) -> None:
        """Take over the exact z-depth (height, width) in millimetres of the next image; NaN where nothing was hit.

        Raises:
            InvalidValueError: If the shape differs from the rig's images.
        """
        size = (self._rig.camera.height, self._rig.camera.width)
        if depth_mm.shape != size:
            raise InvalidValueError("shape of depth_mm", depth_mm.shape, f"(height, width) = {size}")
        self._truth = np.array(depth_mm, dtype=np.float32)

    def estimate(self, image: NDArray[np.uint8]) -> DepthEstimate:
        """Return what was shown, valid wherever there was a surface.

        Raises:
            InvalidValueError: If nothing was shown yet or the image is not the rig's.
        """
        check_image(image, self._rig)
        if self._truth is None:
            raise InvalidValueError("truth seen by the oracle", None, "a depth map given by see_truth before estimate")
        return self.estimate_of(self._truth)

    def estimate_of(self, depth_mm: NDArray[np.float32]) -> DepthEstimate:
        """Return exact depth, (height, width) in millimetres, as an estimate without an image: valid where it is finite."""
        valid = np.isfinite(depth_mm)
        return DepthEstimate(depth_mm=np.where(valid, depth_mm, np.float32(0.0)), valid=valid)
