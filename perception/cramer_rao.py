"""How well depth can be known at best: the Cramér-Rao bound of the stripes' phase under the sensor's noise.

A pixel collects `mu (1 + C cos(phi))` electrons on average, mu being the local mean and C the contrast; shot noise gives that
number as its variance, read noise and rounding to grey values add theirs, v. M pixels that sample whole periods evenly hold
the Fisher information about phi

    J = M mean[(mu C sin)² / (mu (1 + C cos) + v)] = M (a - sqrt(a² - (mu C)²)),    a = mu + v,

whether mu and C are known or not, for sine and cosine are orthogonal over a period. Depth follows from
`phi = 2 pi (x_c - b / Z) / tau`, so that no unbiased estimate is better than

    sigma_Z = tau Z² / (2 pi b sqrt(J)).

The variance of the noise is taken as known: it depends on phi, too, but adds next to nothing at these counts. Harmonics of
sharp stripes carry more than the sine does; a network that knows tissues uses more rows than a window has. The floor is that
of single-shot phase in a stated window, no more.
"""

import math
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from laploop.configuration import Field, configuration
from laploop.errors import InvalidValueError
from laploop.perception.estimators.phase import PhaseConfig, PhaseEstimator
from laploop.perception.geometry import Rig

Floating = NDArray[np.floating]


@configuration
class SensorNoise:
    """What a sensor adds to an image, in photo-electrons."""

    full_well_electrons: Annotated[float, Field(ge=100.0, le=1e6)] = 10500.0
    """Full scale of the grey values; of a Pregius-class sensor."""
    read_noise_electrons: Annotated[float, Field(ge=0.0, le=1000.0)] = 2.5
    """Standard deviation of the read noise."""
    bits: Annotated[int, Field(ge=1, le=16)] = 8
    """Of a grey value."""

    @property
    def electrons_per_grey(self) -> float:
        """Electrons between neighbouring grey values."""
        return self.full_well_electrons / (2.0**self.bits - 1.0)

    @property
    def variance(self) -> float:
        """Variance of read noise and rounding together, electrons squared."""
        return self.read_noise_electrons**2 + self.electrons_per_grey**2 / 12.0


def phase_floor_rad(mean_electrons: Floating, contrast: Floating, variance: float, samples: float) -> NDArray[np.float64]:
    """Return the least standard deviation of the stripes' phase, radians; infinite where there is no contrast.

    Args:
        mean_electrons: Mean of bright and dark, any shape.
        contrast: Michelson contrast, 0 to 1, of the same shape.
        variance: Of everything but shot noise, electrons squared.
        samples: Pixels in the window.

    Raises:
        InvalidValueError: If the window or the variance is impossible.
    """
    if not samples > 0.0:
        raise InvalidValueError("samples", samples, "above 0 pixels")
    if not variance >= 0.0:
        raise InvalidValueError("variance", variance, "0 or more electrons squared")
    mean = np.maximum(np.asarray(mean_electrons, dtype=np.float64), 0.0)
    amplitude = mean * np.clip(np.asarray(contrast, dtype=np.float64), 0.0, 1.0)
    level = mean + variance
    # a - sqrt(a² - b²) without the difference of nearly equal numbers.
    bottom = level + np.sqrt(np.maximum(level**2 - amplitude**2, 0.0))
    information = samples * amplitude**2 / np.maximum(bottom, 1e-30)
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / np.sqrt(information))


def depth_floor_mm(rig: Rig, depth_mm: Floating, phase_rad: Floating) -> NDArray[np.float64]:
    """Triangulate an error of phase: its standard deviation in radians becomes one of depth in millimetres, at `depth_mm`."""
    depth_m = 1e-3 * np.asarray(depth_mm, dtype=np.float64)
    return np.asarray(1e3 * rig.mask.period_tan * depth_m**2 / (2.0 * math.pi * rig.baseline_m) * phase_rad)


class CramerRaoBound:
    """The floor of every pixel of an image, with mean and contrast of the stripes as they are around it."""

    def __init__(self, rig: Rig, noise: SensorNoise | None = None) -> None:
        self.rig = rig
        self.noise = noise or SensorNoise()
        self._config = PhaseConfig()
        self._reader = PhaseEstimator(rig=rig, config=self._config)

    @property
    def period_px(self) -> float:
        """Width of the window: one period of the stripes."""
        return self.rig.mask.period_tan * self.rig.camera.fx

    def sigma_mm(self, image: NDArray[np.uint8], depth_mm: Floating, *, rows: int = 1) -> NDArray[np.float64]:
        """Return the least standard deviation of depth at each pixel, (H, W), from grey values and exact depth, both (H, W).

        The window is one period wide and `rows` pixels high. NaN where the floor has no meaning: where there is no depth, and
        where the stripes are too faint to be distinguished from noise or too bright for the sensor.

        Raises:
            InvalidValueError: If a shape or the window is impossible.
        """
        if rows < 1:
            raise InvalidValueError("rows", rows, "an integer from 1")
        if image.shape != depth_mm.shape:
            raise InvalidValueError("shapes of image and depth_mm", (image.shape, depth_mm.shape), "two equal shapes")
        seen = self._reader.demodulate(image)
        contrast = np.clip(seen.contrast, 1e-6, 1.0)
        mean_electrons = seen.amplitude / contrast * self.noise.electrons_per_grey
        phase = phase_floor_rad(mean_electrons, contrast, self.noise.variance, rows * self.period_px)
        sigma = depth_floor_mm(self.rig, depth_mm, phase)
        readable = (
            (seen.amplitude >= self._config.min_amplitude)
            & (seen.contrast >= self._config.min_contrast)
            & (image < self._config.saturated)
        )
        return np.where(readable & np.isfinite(sigma), sigma, np.nan)
