"""The stripes as a carrier wave whose phase holds inverse depth.

A bright stripe is centred where the mask coordinate `x_p` fulfils `angle(x_p) = 0 (mod 2 pi)`. With `x_p = x_c - b / Z` the
image is `I = A + B cos(angle(x_c) - 2 pi turns)` plus harmonics, where `turns = b / (tau Z)` and tau is the stripes' period.
Multiplied by `exp(-i angle(x_c))` and low-passed, what is left is `B / 2 exp(-2 pi i turns)`: its phase is linear in
inverse depth, and known once per turn.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from laploop.perception.geometry import Rig

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class StripeCarrier:
    """The carrier that a rig's stripes would draw on a surface infinitely far away."""

    rig: Rig

    @property
    def period_px(self) -> float:
        """Period of the carrier in pixels, which is that of the stripes on every surface that faces the camera."""
        return self.rig.mask.period_tan * self.rig.camera.fx

    @property
    def turns_metre(self) -> float:
        """The factor b / tau: turns of phase times depth in metres."""
        return self.rig.baseline_m / self.rig.mask.period_tan

    @cached_property
    def angle(self) -> Array:
        """Phase in radians at each column's centre, (width,)."""
        camera, mask = self.rig.camera, self.rig.mask
        x = (np.arange(camera.width, dtype=np.float64) + 0.5 - camera.cx) / camera.fx
        periods = (x + mask.half_width_tan) / mask.period_tan - mask.phase - 0.5 * mask.duty
        return 2.0 * np.pi * periods


def gaussian_matrix(size: int, sigma: float) -> Array:
    """Return the (size, size) matrix that smooths a vector with a Gaussian of `sigma` samples.

    Each row sums to 1, also at the ends, where the kernel is cut and scaled up again. `m @ image @ n.T` smooths along both
    axes; at image sizes this costs less than a convolution and has no borders to treat.
    """
    index = np.arange(size, dtype=np.float64)
    kernel: Array = np.exp(-0.5 * ((index[:, None] - index[None, :]) / sigma) ** 2)
    kernel[kernel < 1e-5] = 0.0
    kernel /= kernel.sum(axis=1, keepdims=True)
    return kernel
