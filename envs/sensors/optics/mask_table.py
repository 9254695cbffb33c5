"""The stripe mask's transmission, blurred in advance for every amount of blur."""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.special import erf

from laploop.arrays import Array, Float32
from laploop.assets.stripe_mask import StripeMask
from laploop.errors import InvalidValueError

FINE_COLUMNS = 4097
"""Default columns of a table, each a twelfth of a pixel of the nominal camera."""

_LEVELS = 33


@dataclass(frozen=True, kw_only=True, eq=False)
class MaskTable:
    """Transmission along x for a series of blur widths, interpolated linearly in both.

    The dark surround of the mask is part of the pattern, so that its edges blur like the stripes.
    """

    transmission: Float32
    """(levels, columns), read-only: a level is a standard deviation of the blur, a column a tangent coordinate."""
    start: float
    step: float
    sigma_step: float

    @classmethod
    @functools.lru_cache(maxsize=4)
    def from_mask(cls, mask: StripeMask, columns: int = FINE_COLUMNS) -> "MaskTable":
        """Compute the table, stripes in closed form: each bright stripe is a difference of two error functions.

        The roughness of the edges widens every blur. Equal masks share one table, as it takes a tenth of a second and
        environments make a camera an episode. For a new mask in every image use fewer columns: 1025 take a quarter of the time.

        Raises:
            InvalidValueError: If the number of columns is not from 257 to 16385.
        """
        if not 257 <= columns <= 16385:
            raise InvalidValueError("columns", columns, "an integer from 257 to 16385")
        sigma_step = 0.8 * mask.period_tan / (_LEVELS - 1)
        x_max = mask.half_width_tan + 4.0 * 0.8 * mask.period_tan
        x = np.linspace(-x_max, x_max, columns)
        sigmas = [math.hypot(level * sigma_step, mask.edge_roughness * mask.period_tan) for level in range(_LEVELS)]
        table = _stripes(mask, x, sigmas) if mask.profile is None else _steps(mask.half_width_tan, mask.profile, x, sigmas)
        transmission = table.astype(np.float32)
        transmission.flags.writeable = False
        return cls(transmission=transmission, start=-x_max, step=float(x[1] - x[0]), sigma_step=sigma_step)


def _stripes(mask: StripeMask, x: Array, sigmas: Sequence[float]) -> Array:
    """Return the blurred stripes, (sigmas, x)."""
    starts = -mask.half_width_tan + (np.arange(-1, mask.stripes + 1) + mask.phase % 1.0) * mask.period_tan
    left = np.clip(starts, -mask.half_width_tan, mask.half_width_tan)
    right = np.clip(starts + mask.duty * mask.period_tan, -mask.half_width_tan, mask.half_width_tan)
    table = np.empty((len(sigmas), len(x)))
    for level, sigma in enumerate(sigmas):
        width = np.sqrt(2.0) * max(sigma, 1e-9)
        table[level] = 0.5 * (erf((x[:, None] - left) / width) - erf((x[:, None] - right) / width)).sum(axis=1)
    return table


def _steps(half_width: float, profile: Sequence[float], x: Array, sigmas: Sequence[float]) -> Array:
    """Return blurred steps of any transmission, (sigmas, x): means over the columns of the table, filtered."""
    step = float(x[1] - x[0])
    borders = np.linspace(-half_width, half_width, len(profile) + 1)
    integral = np.concatenate([[0.0], np.cumsum(profile) * (borders[1] - borders[0])])
    edges = np.append(x - 0.5 * step, x[-1] + 0.5 * step)
    sharp = np.diff(np.interp(edges, borders, integral)) / step
    return np.stack([gaussian_filter1d(sharp, max(sigma / step, 1e-3), mode="constant", truncate=6.0) for sigma in sigmas])
