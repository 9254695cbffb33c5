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


def to_eight_bits(image: NDArray[np.uint16], bits: int = 12) -> NDArray[np.uint8]:
    """Round the grey values of a camera with more bits to those that estimators take.

    Args:
        image: (height, width), from 0 to 2**bits - 1.
        bits: Of the camera's output, 9 to 16.

    Raises:
        InvalidValueError: If the type, the number of bits or a grey value does not fit.
    """
    if not isinstance(image, np.ndarray) or image.dtype != np.uint16:
        raise InvalidValueError("type of image", getattr(image, "dtype", type(image)), "a numpy array of uint16")
    if not 9 <= bits <= 16:
        raise InvalidValueError("bits", bits, "9 to 16")
    full = 2**bits - 1
    brightest = int(image.max(initial=0))
    if brightest > full:
        raise InvalidValueError("brightest grey value of the image", brightest, f"at most {full}, as {bits} bits hold")
    rounded: NDArray[np.uint8] = ((image.astype(np.uint32) * 510 + full) // (2 * full)).astype(np.uint8)
    return rounded


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
