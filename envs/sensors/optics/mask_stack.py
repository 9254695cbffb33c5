"""Transmission of a mask that varies along both axes, blurred for a series of distances."""

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.ndimage import gaussian_filter1d

from laploop.arrays import Array, Float32
from laploop.assets.mask_pattern import decode_pattern
from laploop.assets.stripe_mask import StripeMask
from laploop.envs.sensors.optics.projection_blur import MARGIN_TAN, ProjectionBlur, disk_transfer

_SIDE = 768
_LEVELS = 17


@dataclass(frozen=True, kw_only=True, eq=False)
class MaskStack:
    """Transmission on a square grid of tangent coordinates as a spectrum, from which `blurred` makes a stack.

    The dark surround of the mask is part of the pattern, on all four sides, so that its edges blur like the rest.
    """

    spectrum: NDArray[np.complex64]
    """(frequencies along y, frequencies along x), read-only: of the sharp pattern's means over the cells of the grid."""
    along_y: Array
    along_x: Array
    """Frequencies along the axes, radians per tangent unit."""
    start: float
    """Coordinate of the first row and of the first column."""
    step: float
    mean: float
    """Mean transmission of the mask."""

    @classmethod
    @functools.lru_cache(maxsize=2)
    def from_mask(cls, mask: StripeMask) -> "MaskStack":
        """Compute the spectrum; a cell is half a pixel of a 256 pixel camera. Equal masks share one."""
        half = mask.half_width_tan + MARGIN_TAN
        step = 2.0 * half / _SIDE
        edges = np.linspace(-half, half, _SIDE + 1)
        if mask.pattern is None:
            sharp = _wandering_stripes(mask, edges)
        else:
            sharp = _picture(mask.half_width_tan, decode_pattern(mask.pattern), edges)
        along_x, along_y = (2.0 * math.pi * f(_SIDE, step).astype(np.float64) for f in (np.fft.rfftfreq, np.fft.fftfreq))
        roughness = np.exp(-0.5 * (mask.edge_roughness * mask.period_tan * along_x) ** 2)
        spectrum = (fft.rfft2(sharp) * roughness).astype(np.complex64)
        spectrum.flags.writeable = False
        mean = float(sharp.sum()) * (step / (2.0 * mask.half_width_tan)) ** 2
        return cls(spectrum=spectrum, along_y=along_y, along_x=along_x, start=-half + 0.5 * step, step=step, mean=mean)

    def blurred(self, blur: ProjectionBlur) -> Float32:
        """Return the transmission for a series of disks, (levels, rows, columns), 40 MB in a tenth of a second.

        The radii are those of `blur.radii`; rows and columns are tangent coordinates along y and x.
        """
        frequency = np.hypot(self.along_y[:, None], self.along_x)
        sharp = self.spectrum * blur.gaussian_transfer(frequency)
        stack = np.empty((_LEVELS, _SIDE, _SIDE), dtype=np.float32)
        for level, radius in enumerate(blur.radii(_LEVELS)):
            stack[level] = fft.irfft2(sharp * disk_transfer(radius, frequency), s=(_SIDE, _SIDE))
        # Transfer functions of narrow blurs are cut off at the grid's limit, which leaves ripples around 0 and 1.
        return np.clip(stack, 0.0, 1.0, out=stack)


def _picture(half_width: float, pattern: Array, edges: Array) -> Array:
    """Return the mean of a pattern that fills the mask over the cells between the edges, (rows, columns)."""
    down, across = (_overlaps(half_width, count, edges) for count in pattern.shape)
    means: Array = down @ pattern @ across.T
    return means


def _overlaps(half_width: float, count: int, edges: Array) -> Array:
    """Return the fraction of each cell between the edges that each of `count` pixels covers, (cells, pixels)."""
    borders = np.linspace(-half_width, half_width, count + 1)
    upper = np.minimum(edges[1:, None], borders[None, 1:])
    lower = np.maximum(edges[:-1, None], borders[None, :-1])
    return np.asarray(np.clip(upper - lower, 0.0, None) / (edges[1] - edges[0]))


def _wandering_stripes(mask: StripeMask, edges: Array) -> Array:
    """Return the mean of stripes with wandering edges over the cells between the edges, (rows, columns)."""
    half, period = mask.half_width_tan, mask.period_tan
    count = len(edges) - 1
    step = float(edges[1] - edges[0])
    starts = -half + (np.arange(-1, mask.stripes + 1) + mask.phase % 1.0) * period
    wander = mask.edge_wander * period * _smooth_noise(mask, (count, 2 * len(starts)), step)
    left = np.clip(starts + wander[:, ::2], -half, half)
    right = np.clip(starts + mask.duty * period + wander[:, 1::2], -half, half)
    sharp = np.zeros((count, count))
    for k in range(len(starts)):
        upper = np.minimum(edges[None, 1:], right[:, k, None])
        lower = np.maximum(edges[None, :-1], left[:, k, None])
        sharp += np.clip(upper - lower, 0.0, None)
    inside = _overlaps(half, 1, edges)
    # Where two stripes wander into each other, they are no brighter than clear glass.
    return np.minimum(sharp / step, 1.0) * inside


def _smooth_noise(mask: StripeMask, shape: tuple[int, int], step: float) -> Array:
    """Return standard normal numbers, correlated along the first axis by the mask's length, independent along the second."""
    # White noise blurred by s has a Gaussian correlation of width s * sqrt(2). The noise starts outside the grid, so that the
    # grid's borders are no exception.
    sigma = mask.edge_correlation * mask.period_tan / math.sqrt(2.0) / step
    margin = math.ceil(4.0 * sigma)
    white = np.random.default_rng(mask.edge_seed).standard_normal((shape[0] + 2 * margin, shape[1]))
    smooth = gaussian_filter1d(white, sigma, axis=0, mode="nearest")
    impulse = np.zeros(2 * margin + 1)
    impulse[margin] = 1.0
    gain = np.sqrt(np.sum(gaussian_filter1d(impulse, sigma, mode="constant") ** 2))
    noise: Array = smooth[margin : margin + shape[0]] / gain
    return noise
