"""A capture of the stripe camera, and the exact geometry behind it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthView:
    """What each pixel's centre shows, (height, width)."""

    depth_mm: NDArray[np.float32]
    """z-depth in the camera's frame; NaN where there is no surface."""
    object_id: NDArray[np.uint8]
    """An `ObjectId`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ExactView(DepthView):
    """Exact geometry at each pixel's centre, (height, width, ...); NaN where there is no surface."""

    normals: NDArray[np.float32]
    """(height, width, 3), unit surface normals in the camera's frame, towards the camera; smooth across triangles."""
    projector_x: NDArray[np.float32]
    """Tangent coordinate on the mask along x, in the projector's frame."""
    projector_y: NDArray[np.float32]
    """The same along y, along the stripes."""
    lit: NDArray[np.bool_]
    """True where the projector's centre sees the point and it lies inside the mask's field."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StripeCapture(ExactView):
    """An image of the camera channel with the exact geometry behind it."""

    image: NDArray[Any]
    """(height, width), grey values: uint8, or uint16 from 0 to 4095 with 12 bits."""
    electrons: NDArray[np.float32]
    """(height, width), expected photo-electrons before noise, saturation and quantisation."""
