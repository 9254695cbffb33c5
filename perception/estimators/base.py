"""The contract of every depth estimator."""

from dataclasses import replace
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
        """Estimate z-depth in millimetres and its validity from an image (height, width).

        Raises:
            InvalidValueError: If the image is not what the rig's camera delivers.
        """
        ...


def checked_estimate(estimate: object, shape: tuple[int, int]) -> DepthEstimate:
    """Check what an estimator returned, at the seam where a user's own may stand.

    Args:
        estimate: What `DepthEstimator.estimate` returned.
        shape: (height, width) of the image it was given.

    Returns:
        The estimate; depth that is not finite becomes 0 where it is marked invalid.

    Raises:
        InvalidValueError: If it is no `DepthEstimate`, has another shape, or a valid depth is not finite and above 0.
    """
    if not isinstance(estimate, DepthEstimate):
        found = "nothing" if estimate is None else _in_words(estimate)
        raise InvalidValueError("estimate", found, f"a DepthEstimate with depth_mm and valid of shape {shape}")
    depth_mm, valid = estimate.depth_mm, estimate.valid
    if depth_mm.shape != shape:
        raise InvalidValueError("shape of the estimate", depth_mm.shape, f"{shape}, that of the image")
    finite = np.isfinite(depth_mm)
    wrong = valid & ~(finite & (depth_mm > 0.0))
    if wrong.any():
        allowed = f"finite and above 0 where valid is True; {int(wrong.sum())} of {wrong.size} pixels are not"
        raise InvalidValueError("depth_mm of the estimate", float(depth_mm[wrong][0]), allowed)
    if finite.all():
        return estimate
    return replace(estimate, depth_mm=np.where(finite, depth_mm, np.float32(0.0)))


def _in_words(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"an array of {value.dtype}, shape {value.shape}"
    return f"{type(value).__module__}.{type(value).__qualname__}".removeprefix("builtins.")


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
    """Raise an `InvalidValueError` unless an image has the type and the size that the rig's camera delivers."""
    size = (rig.camera.height, rig.camera.width)
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8:
        raise InvalidValueError("type of image", getattr(image, "dtype", type(image)), "a numpy array of uint8")
    if image.shape != size:
        raise InvalidValueError("shape of image", image.shape, f"(height, width) = {size}")
