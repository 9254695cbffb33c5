"""The stripe mask's transmission, blurred in advance for every amount of blur."""

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from laploop.assets.stripe_mask import StripeMask

_COLUMNS = 4097
_LEVELS = 33


@dataclass(frozen=True, kw_only=True, eq=False)
class MaskTable:
    """Transmission along x for a grid of blur widths; both are looked up linearly.

    The dark surround of the mask is part of the pattern, so that its edges blur as the stripes do.
    """

    transmission: NDArray[np.float32]
    """(levels, columns), read-only: a level is a standard deviation of the blur, a column a tangent coordinate."""
    x_min: float
    x_step: float
    sigma_step: float

    @classmethod
    @functools.lru_cache(maxsize=4)
    def from_mask(cls, mask: StripeMask) -> "MaskTable":
        """Compute the table in closed form: each bright stripe is a difference of two error functions.

        Equal masks share one table, for it takes a sixth of a second and environments make a camera an episode.
        """
        sigma_step = 0.8 * mask.period_tan / (_LEVELS - 1)
        x_max = mask.half_width_tan + 4.0 * 0.8 * mask.period_tan
        x = np.linspace(-x_max, x_max, _COLUMNS)
        starts = -mask.half_width_tan + (np.arange(-1, mask.stripes + 1) + mask.phase % 1.0) * mask.period_tan
        left = np.clip(starts, -mask.half_width_tan, mask.half_width_tan)
        right = np.clip(starts + mask.duty * mask.period_tan, -mask.half_width_tan, mask.half_width_tan)
        table = np.empty((_LEVELS, _COLUMNS))
        for level in range(_LEVELS):
            width = np.sqrt(2.0) * max(level * sigma_step, 1e-9)
            table[level] = 0.5 * (erf((x[:, None] - left) / width) - erf((x[:, None] - right) / width)).sum(axis=1)
        transmission = table.astype(np.float32)
        transmission.flags.writeable = False
        return cls(transmission=transmission, x_min=-x_max, x_step=float(x[1] - x[0]), sigma_step=sigma_step)
