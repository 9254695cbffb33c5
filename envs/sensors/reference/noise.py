"""Errors of a reference camera: scale, bend and noise."""

import numpy as np
from numpy.typing import NDArray

from laploop.arrays import Array, Float32
from laploop.envs.sensors.reference.optics import ReferenceOptics

_NOISE_DISTANCE_MM = 600.0
"""Distance at which the data sheet states the noise: the camera's focus."""
_BEND_GRID = 65
_LEAST_QUALITY = np.float32(0.05)
"""Lower bound of relative SNR times cosine: noise is at most twenty times the nominal, even for dark points that are kept."""


class ReferenceNoise:
    """Depth errors of one camera: z' = z (1 + s) + bend(x, y) + n.

    The scale error s is drawn once, uniformly within the dimension trueness. The bend is a polynomial of second and third
    order in the image coordinates, drawn once, whose peak is at least half of what the planarity trueness allows. Noise n is
    normal, new at every point, with a standard deviation proportional to the distance and to 1/(SNR cos), where the cosine is
    that of the angle between surface normal and line of sight.
    """

    def __init__(self, optics: ReferenceOptics) -> None:
        """Draw the errors of the camera with the seed `optics.unit_seed`."""
        rng = np.random.default_rng(optics.unit_seed)
        self._optics = optics
        self.scale = float(rng.uniform(-1.0, 1.0)) * optics.dimension_trueness
        """The scale error s."""
        weights = rng.standard_normal(6)
        peak_mm = float(rng.uniform(0.5, 1.0)) * optics.planarity_trueness_mm
        grid = np.arange(_BEND_GRID) * (2.0 / (_BEND_GRID - 1)) - 1.0
        weights *= peak_mm / np.abs(_bend(weights, grid, grid)).max()
        column, row, width, height = optics.window
        # The bend is a property of the whole image, of which a region is a part.
        x = (np.arange(column, column + width) + 0.5) * (2.0 / (optics.width // optics.step)) - 1.0
        y = (np.arange(row, row + height) + 0.5) * (2.0 / (optics.height // optics.step)) - 1.0
        limit = optics.planarity_trueness_mm
        self.bend_mm: Float32 = np.clip(_bend(weights, x, y), -limit, limit).astype(np.float32)
        """(height, width), the bend."""

    def sigma_mm(self, z_mm: Float32, relative_snr: Float32, cosine: Float32) -> Float32:
        """Return the standard deviation of z for points of any shape; `cosine` is of the angle to the line of sight."""
        quality = np.maximum(relative_snr * cosine, _LEAST_QUALITY)
        return np.asarray(np.float32(self._optics.point_noise_mm / _NOISE_DISTANCE_MM) * z_mm / quality)

    def normal_sigma_rad(self, z_mm: Float32, sigma_mm: Float32) -> Float32:
        """Return the standard deviation of a normal's direction, of the slope of a plane through a square of points.

        The points of a w x w square lie `pitch = z / f` apart; the slope of a least-squares plane through them has the
        standard deviation sigma / (pitch sqrt(w² (w² - 1) / 12)).
        """
        window = self._optics.normal_window_px
        spread = np.sqrt(window**2 * (window**2 - 1) / 12.0)
        return sigma_mm / z_mm * np.float32(self._optics.intrinsics.fx / spread)


def _bend(weights: Array, x: NDArray[np.floating], y: NDArray[np.floating]) -> Array:
    """Evaluate the polynomial on the grid of x and y, both -1 to 1 across the image; (len(y), len(x))."""
    x, y = x[None, :], y[:, None]
    terms = (2.0 * x**2 - 1.0 + 0.0 * y, 2.0 * y**2 - 1.0 + 0.0 * x, x * y, x**3 + 0.0 * y, y**3 + 0.0 * x, x * y**2)
    return np.asarray(sum(weight * term for weight, term in zip(weights, terms, strict=True)))
