"""The contract of every depth estimator."""

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from laploop.errors import InvalidValueError
from laploop.perception.geometry import Rig
from laploop.perception.messages import DepthEstimate


@runtime_checkable
class DepthEstimator(Protocol):
    """Anything that turns one stripe image into metric depth.

    The same image gives the same estimate, bit for bit, whatever was seen before it.
    """

    def estimate(self, image: NDArray[np.uint8]) -> DepthEstimate:
        """Estimate z-depth in millimetres and its validity from an image (height, width)."""
        ...


def check_image(image: NDArray[np.uint8], rig: Rig) -> None:
    """Refuse an image that is not what the rig's camera delivers.

    Raises:
        InvalidValueError: If type or size differ.
    """
    size = (rig.camera.height, rig.camera.width)
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8:
        raise InvalidValueError("type of image", getattr(image, "dtype", type(image)), "a numpy array of uint8")
    if image.shape != size:
        raise InvalidValueError("shape of image", image.shape, f"(height, width) = {size}")
