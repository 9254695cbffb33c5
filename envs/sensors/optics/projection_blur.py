"""The blur of a projected mask: a disk by the aperture, and a Gaussian by source and pixel."""

from dataclasses import dataclass

import numpy as np
from scipy.special import j1

from laploop.arrays import Array, Float32

_NEAREST_M = 0.015
"""Nearest surface whose defocus the tables hold; nearer ones are blurred as much as at this distance."""
_WIDEST_SIGMA_TAN = 0.045
MARGIN_TAN = 0.18
"""How far tables reach beyond the mask: four of the widest standard deviations, or a usual projector's largest disk and four of
its standard deviations."""


@dataclass(frozen=True, kw_only=True)
class ProjectionBlur:
    """Blur of the mask on a surface at the distance z from the projector, tangent units.

    A round aperture of diameter D sends light to a point at the tangent coordinate t through all mask coordinates
    t + a (1/focus - 1/z), where a is a point of the aperture: a uniform disk of the radius D/2 |1/z - 1/focus|. Finite source
    and pixel add a Gaussian of a width that does not depend on z.
    """

    sigma_tan: float
    """Standard deviation of the Gaussian."""
    aperture_m: float
    """Diameter of the projection lens's aperture."""
    focus_m: float
    """Distance at which the mask is imaged sharply."""

    @property
    def largest_radius_tan(self) -> float:
        """Radius of the largest disk: that of the nearest or that of the farthest surface."""
        focus = 1.0 / self.focus_m
        return 0.5 * self.aperture_m * max(focus, 1.0 / _NEAREST_M - focus)

    def radii(self, levels: int) -> Array:
        """Return equally spaced radii from 0 to the largest, (levels,)."""
        return np.linspace(0.0, self.largest_radius_tan, levels)

    def gaussian_transfer(self, frequency: Array) -> Float32:
        """Return the Gaussian's transfer at spatial frequencies in radians per tangent unit, of any shape."""
        sigma = min(self.sigma_tan, _WIDEST_SIGMA_TAN)
        return np.exp(-0.5 * (sigma * frequency) ** 2).astype(np.float32)


def disk_transfer(radius_tan: float, frequency: Array) -> Float32:
    """Return the transfer of a uniform disk at spatial frequencies in radians per tangent unit, of any shape.

    It is 2 J1(k r) / (k r), along one axis as well as over two (Goodman, Introduction to Fourier Optics, 2005, section 2.1.6).
    """
    phase = np.maximum(radius_tan * np.abs(frequency), 1e-6)
    return np.asarray(2.0 * j1(phase) / phase, dtype=np.float32)
