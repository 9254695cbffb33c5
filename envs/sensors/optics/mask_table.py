"""The stripe mask's transmission along x, blurred for a series of distances."""

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from laploop.arrays import Array, Float32
from laploop.assets.stripe_mask import StripeMask
from laploop.envs.sensors.optics.projection_blur import MARGIN_TAN, ProjectionBlur, disk_transfer
from laploop.errors import InvalidValueError

FINE_COLUMNS = 4097
"""Default columns of a table, each an eleventh of a pixel of the nominal camera."""

_LEVELS = 33


@dataclass(frozen=True, kw_only=True, eq=False)
class MaskTable:
    """Transmission along x as a spectrum, from which `blurred` makes a table.

    The dark surround of the mask is part of the pattern, so that its edges blur like the stripes.
    """

    spectrum: NDArray[np.complex64]
    """(frequencies,), read-only: of the sharp pattern's means over the columns, followed by zeros."""
    frequencies: Array
    """(frequencies,), radians per tangent unit."""
    start: float
    """Tangent coordinate of the first column."""
    step: float
    columns: int
    mean: float
    """Mean transmission of the mask."""

    @classmethod
    @functools.lru_cache(maxsize=4)
    def from_mask(cls, mask: StripeMask, columns: int = FINE_COLUMNS) -> "MaskTable":
        """Compute the spectrum; the roughness of the edges is a Gaussian blur of the pattern.

        Equal masks share one. For a new mask in every image use fewer columns: 1025 take a quarter of the time.

        Raises:
            InvalidValueError: If the number of columns is not from 257 to 16385.
        """
        if not 257 <= columns <= 16385:
            raise InvalidValueError("columns", columns, "an integer from 257 to 16385")
        half = mask.half_width_tan
        x = np.linspace(-half - MARGIN_TAN, half + MARGIN_TAN, columns)
        step = float(x[1] - x[0])
        edges = np.append(x - 0.5 * step, x[-1] + 0.5 * step)
        borders, integral = _stripes(mask) if mask.profile is None else _steps(half, np.array(mask.profile))
        sharp = np.diff(np.interp(edges, borders, integral)) / step
        length = fft.next_fast_len(columns, real=True)
        frequencies: Array = 2.0 * np.pi * np.fft.rfftfreq(length, step).astype(np.float64)
        roughness = np.exp(-0.5 * (mask.edge_roughness * mask.period_tan * frequencies) ** 2)
        spectrum = (fft.rfft(sharp, n=length) * roughness).astype(np.complex64)
        spectrum.flags.writeable = frequencies.flags.writeable = False
        return cls(
            spectrum=spectrum,
            frequencies=frequencies,
            start=float(x[0]),
            step=step,
            columns=columns,
            mean=float(integral[-1]) / (2.0 * half),
        )

    def blurred(self, blur: ProjectionBlur) -> Float32:
        """Return the transmission for a series of disks, (levels, columns): the radii are those of `blur.radii`."""
        transfer = _disk_transfers(blur.largest_radius_tan, self.step, len(self.frequencies))
        spectra = transfer * (self.spectrum * blur.gaussian_transfer(self.frequencies))
        length = fft.next_fast_len(self.columns, real=True)
        table = fft.irfft(spectra, n=length, axis=1)[:, : self.columns]
        # The transfer function of a narrow disk is cut off at the grid's limit, which leaves ripples around 0 and 1.
        transmission: Float32 = np.clip(table, 0.0, 1.0).astype(np.float32, copy=False)
        return transmission


@functools.lru_cache(maxsize=4)
def _disk_transfers(largest_radius: float, step: float, count: int) -> Float32:
    """Return the transfer of each level's disk, (levels, count); it stays while source and mask change."""
    frequencies = np.linspace(0.0, np.pi / step, count)
    radii = np.linspace(0.0, largest_radius, _LEVELS)
    transfers = np.stack([disk_transfer(radius, frequencies) for radius in radii])
    transfers.flags.writeable = False
    return transfers


def _stripes(mask: StripeMask) -> tuple[Array, Array]:
    """Return the borders of the stripes and the integral of the transmission up to each of them."""
    half = mask.half_width_tan
    starts = -half + (np.arange(-1, mask.stripes + 1) + mask.phase % 1.0) * mask.period_tan
    borders = np.clip(np.stack([starts, starts + mask.duty * mask.period_tan], axis=1), -half, half)
    bright = np.stack([np.zeros(len(starts)), borders[:, 1] - borders[:, 0]], axis=1)
    return borders.ravel(), np.cumsum(bright.ravel())


def _steps(half_width: float, profile: Array) -> tuple[Array, Array]:
    """Return the borders of steps of any transmission and the integral up to each of them."""
    borders = np.linspace(-half_width, half_width, len(profile) + 1)
    return borders, np.concatenate([[0.0], np.cumsum(profile) * (borders[1] - borders[0])])
