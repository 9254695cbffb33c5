"""Rays of a camera whose lens distorts."""

import math

import numpy as np

from laploop.arrays import Array
from laploop.errors import InvalidValueError
from laploop.perception.geometry import Intrinsics
from laploop.perception.reprojection import BrownDistortion

_ITERATIONS = 30
_CLOSE_TAN = 1e-12
_DIFFERENCE_TAN = 1e-6


def distorted_rays(camera: Intrinsics, distortion: BrownDistortion) -> Array:
    """Return the rays that the lens maps to all pixel centres, (height, width, 3), scaled to z = 1 in the camera's frame.

    The inverse of `BrownDistortion.apply` at `Intrinsics.rays`, by Newton's method.

    Raises:
        InvalidValueError: If no ray reaches some pixel, because the polynomial folds back.
    """
    if distortion == BrownDistortion():
        return camera.rays
    shown_x, shown_y = camera.rays[..., 0], camera.rays[..., 1]
    x, y = shown_x.copy(), shown_y.copy()
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for _ in range(_ITERATIONS):
            error_x, error_y = (a - b for a, b in zip(distortion.apply(x, y), (shown_x, shown_y), strict=True))
            if max(np.abs(error_x).max(), np.abs(error_y).max()) < _CLOSE_TAN:
                break
            j = _slopes(distortion, x, y)
            determinant = j[0] * j[3] - j[1] * j[2]
            x = x - (j[3] * error_x - j[1] * error_y) / determinant
            y = y - (j[0] * error_y - j[2] * error_x) / determinant
        far = max(np.abs(error_x).max(), np.abs(error_y).max())
        radius = math.sqrt(np.max(x * x + y * y))
    if not (far < 1e3 * _CLOSE_TAN and radius < distortion.largest_radius_tan):
        corner = float(np.hypot(shown_x, shown_y).max())
        raise InvalidValueError(
            "distortion", distortion, f"a lens whose image reaches its corner, at a tangent of {corner:.3f}"
        )
    return np.stack([x, y, np.ones_like(x)], axis=-1)


def _slopes(distortion: BrownDistortion, x: Array, y: Array) -> tuple[Array, Array, Array, Array]:
    """Return the derivatives of the distorted x by x and by y, and of the distorted y by x and by y."""
    h = _DIFFERENCE_TAN
    right, left = distortion.apply(x + h, y), distortion.apply(x - h, y)
    down, up = distortion.apply(x, y + h), distortion.apply(x, y - h)
    xx, xy = (right[0] - left[0]) / (2.0 * h), (down[0] - up[0]) / (2.0 * h)
    yx, yy = (right[1] - left[1]) / (2.0 * h), (down[1] - up[1]) / (2.0 * h)
    return xx, xy, yx, yy
