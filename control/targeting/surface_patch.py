"""A robust local fit of a depth map: the point of the surface under a pixel, and its normal."""

from dataclasses import dataclass

import numpy as np

from laploop.arrays import Array
from laploop.errors import InvalidValueError

_TUKEY = 4.685
"""Tuning constant of the biweight: 95 % efficiency on Gaussian noise."""

_MAD_TO_SIGMA = 1.4826

_FEWEST_FOR_QUADRIC = 12

_SHARES = (0.75, 0.5625)
"""Of the radius: patches to try where the whole is not even."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfacePatch:
    """The surface around a ray, in the camera's frame."""

    point: Array
    """(3,), where the ray meets the surface, metres."""
    normal: Array
    """(3,), unit, towards the camera."""
    spread_m: float
    """Robust standard deviation of the points from the fit, along z."""


def fit_patch(points: Array, ray: Array, *, radius_m: float, min_spread_m: float = 5e-5) -> SurfacePatch:
    """Fit a quadric `z = q(x, y)` to points by iterated reweighting and meet it with a ray.

    The first passes minimise absolute deviations, which outliers (fewer than half) cannot carry far; the last ones weigh
    with Tukey's biweight at the scale of the residuals' median, which ignores outliers. A Gaussian of their lateral distance
    from the ray weighs the points, half at half the radius, so that the fit is good where it is used. With fewer than 12
    points it is a plane.

    Args:
        points: (n, 3), the camera's frame, at least 6; outliers and gaps allowed.
        ray: (3,), the pixel's ray scaled to z = 1.
        radius_m: Size of the patch.
        min_spread_m: Least scale of the biweight.

    Raises:
        InvalidValueError: If there are too few points.
    """
    if len(points) < 6:
        raise InvalidValueError("number of points in the patch", len(points), "6 or more")
    z0 = float(np.median(points[:, 2]))
    for _ in range(2):
        patch, residual_spread = _fit_around(points, ray, z0, radius_m, min_spread_m)
        z0 = float(patch[0])
    gradient = patch[1:]
    normal = np.array([gradient[0], gradient[1], -1.0])
    return SurfacePatch(point=ray * z0, normal=normal / np.linalg.norm(normal), spread_m=residual_spread)


def fit_even_patch(points: Array, ray: Array, *, radius_m: float, max_spread_m: float) -> SurfacePatch:
    """Fit a patch as `fit_patch` does, a smaller one where the whole holds more than one surface.

    Depth networks blur the step from one surface to another into a slope, and a quadric follows that. Patches of 3/4 and 9/16
    of the radius are tried as long as the points spread more about the fit than they should. Where none is even, the depth is
    noisy, and the whole is best.

    Args:
        points: (n, 3), as for `fit_patch`; those within the radius.
        ray: (3,), the pixel's ray scaled to z = 1.
        radius_m: Size of the largest patch.
        max_spread_m: Greatest robust standard deviation of a patch that holds one surface.

    Raises:
        InvalidValueError: If there are too few points.
    """
    whole = fit_patch(points, ray, radius_m=radius_m)
    lateral = np.hypot(points[:, 0] - ray[0] * points[:, 2], points[:, 1] - ray[1] * points[:, 2])
    patch = whole
    for share in _SHARES:
        near = points[lateral < share * radius_m]
        if patch.spread_m <= max_spread_m or len(near) < _FEWEST_FOR_QUADRIC:
            break
        patch = fit_patch(near, ray, radius_m=share * radius_m)
    return patch if patch.spread_m <= max_spread_m else whole


def _fit_around(points: Array, ray: Array, z0: float, radius_m: float, min_spread_m: float) -> tuple[Array, float]:
    """Fit about the point of the ray at depth z0; return its refined depth and the slopes there, (3,), and the spread."""
    x = (points[:, 0] - ray[0] * z0) / radius_m
    y = (points[:, 1] - ray[1] * z0) / radius_m
    z = points[:, 2] - z0
    columns = [np.ones_like(x), x, y]
    if len(points) >= _FEWEST_FOR_QUADRIC:
        columns += [x * x, x * y, y * y]
    basis = np.stack(columns, axis=-1)
    near = np.exp(-np.log(2.0) * 4.0 * (x * x + y * y))
    weight = near
    coefficients = np.zeros(basis.shape[1])
    spread = min_spread_m
    for iteration in range(10):
        weighted = basis * weight[:, None]
        coefficients = np.linalg.lstsq(weighted.T @ basis, weighted.T @ z, rcond=1e-10)[0]
        residual = np.abs(z - basis @ coefficients)
        if iteration < 5:
            weight = near / np.maximum(residual, min_spread_m)
            continue
        spread = max(_MAD_TO_SIGMA * float(np.median(residual)), min_spread_m)
        weight = near * np.maximum(1.0 - (residual / (_TUKEY * spread)) ** 2, 0.0) ** 2
    slopes = coefficients[1:3] / radius_m
    # Along the ray x and y grow with z: solve z = c + slopes . ray (z - z0) to first order about the patch's middle.
    refined = z0 + coefficients[0] / max(1.0 - float(slopes @ ray[:2]), 0.2)
    return np.array([refined, slopes[0], slopes[1]]), spread
