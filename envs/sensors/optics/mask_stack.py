"""Transmission of a mask that varies along both axes, blurred in advance for every amount of blur."""

import functools
import math
from dataclasses import dataclass

import numpy as np
from scipy import fft
from scipy.ndimage import gaussian_filter1d

from laploop.arrays import Array, Float32
from laploop.assets.mask_pattern import decode_pattern
from laploop.assets.stripe_mask import StripeMask

_SIDE = 768
_LEVELS = 33
_WIDEST_PERIODS = 0.8
_WIDEST_TAN = (0.03, 0.06)
_MARGIN_SIGMAS = 4.0


@dataclass(frozen=True, kw_only=True, eq=False)
class MaskStack:
    """Transmission on a square grid of tangent coordinates for a series of blur widths, interpolated linearly in all three.

    The dark surround of the mask is part of the pattern, on all four sides, so that its edges blur like the rest.
    """

    transmission: Float32
    """(levels, rows, columns), read-only: a level is a standard deviation of the blur, rows and columns tangent coordinates
    along y and x."""
    start: float
    """Coordinate of the first row and of the first column."""
    step: float
    sigma_step: float

    @classmethod
    @functools.lru_cache(maxsize=2)
    def from_mask(cls, mask: StripeMask) -> "MaskStack":
        """Compute the stack, 78 MB in half a second; equal masks share one.

        The sharp pattern is averaged over the cells of the grid, half a pixel of a 256 pixel camera, and blurred by the
        Gaussian's transfer function. Blurs extend to 0.8 periods, as in `MaskTable`, but at least to 0.03 and at most to 0.06
        tangent units, twice the blur of the nominal scope's projector on tissue 30 mm away.
        """
        widest = float(np.clip(_WIDEST_PERIODS * mask.period_tan, *_WIDEST_TAN))
        half = mask.half_width_tan + _MARGIN_SIGMAS * widest
        step = 2.0 * half / _SIDE
        edges = np.linspace(-half, half, _SIDE + 1)
        if mask.pattern is None:
            sharp = _wandering_stripes(mask, edges)
        else:
            sharp = _picture(mask.half_width_tan, decode_pattern(mask.pattern), edges)
        spectrum = fft.rfft2(sharp)
        along_x, along_y = np.fft.rfftfreq(_SIDE, step), np.fft.fftfreq(_SIDE, step)
        soft = mask.edge_roughness * mask.period_tan
        stack = np.empty((_LEVELS, _SIDE, _SIDE), dtype=np.float32)
        for level in range(_LEVELS):
            sigma = level * widest / (_LEVELS - 1)
            transfer_x = np.exp(-2.0 * (math.pi * along_x) ** 2 * (sigma**2 + soft**2))
            transfer_y = np.exp(-2.0 * (math.pi * along_y * sigma) ** 2)
            stack[level] = fft.irfft2(spectrum * transfer_x * transfer_y[:, None], s=(_SIDE, _SIDE))
        # A narrow Gaussian's transfer function is cut off at the grid's limit, which leaves ripples around 0 and 1.
        np.clip(stack, 0.0, 1.0, out=stack)
        stack.flags.writeable = False
        return cls(transmission=stack, start=-half + 0.5 * step, step=step, sigma_step=widest / (_LEVELS - 1))


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
