"""Single-frame phase demodulation and triangulation: the classical method."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from laploop.configuration import Field, configuration
from laploop.errors import InvalidValueError
from laploop.perception.carrier import StripeCarrier, gaussian_matrix
from laploop.perception.estimators.base import check_image
from laploop.perception.geometry import Rig
from laploop.perception.messages import DepthEstimate
from laploop.perception.working_range import WORKING_RANGE_MM

Millimetres = Annotated[float, Field(gt=0.0, le=10_000.0)]


@configuration
class PhaseConfig:
    """How the phase is read, and which pixels are valid."""

    nearest_mm: Millimetres = WORKING_RANGE_MM[0]
    """Near end of the turn of phase that is taken to be the right one; the far end follows from the rig (195 mm)."""
    farthest_mm: Millimetres = WORKING_RANGE_MM[1]
    """Depths beyond are invalid; a turn later the tool, close to the scope, would look as far away as this."""
    window_periods: Annotated[float, Field(gt=0.0, le=10.0)] = 0.6
    """Standard deviation of the Gaussian window along the stripes' x, in periods: about one is a fair default, less keeps
    slopes and edges sharp, more averages noise."""
    support_px: Annotated[float, Field(gt=0.0, le=100.0)] = 3.0
    """Standard deviation of the averaging across rows."""
    min_amplitude: Annotated[float, Field(ge=0.0, le=255.0)] = 3.0
    """Least amplitude of the stripes, in grey values, above the camera's noise."""
    min_contrast: Annotated[float, Field(ge=0.0, le=1.0)] = 0.12
    """Least amplitude relative to the local mean."""
    max_residual: Annotated[float, Field(gt=0.0, le=100.0)] = 0.6
    """Largest misfit of the fitted wave, root mean square relative to its amplitude."""
    max_misfit_mm: Millimetres = 10.0
    """Largest misfit when it is read as an error of phase of a single pixel and triangulated; averaging over the window makes
    the estimate some ten times better. It grows with the square of depth, as the estimate's own error does."""
    max_slope_mm: Millimetres = 1.0
    """Largest step of depth between neighbouring pixels."""
    margin_periods: Annotated[float, Field(ge=0.0, le=100.0)] = 0.8
    """What is nearer to the left or right end of the image or of the lit field is invalid: the window hangs over."""
    saturated: Annotated[int, Field(ge=1, le=255)] = 253
    """Grey value from which a pixel counts as saturated."""

    def __post_init__(self) -> None:
        if self.nearest_mm >= self.farthest_mm:
            raise InvalidValueError("nearest_mm and farthest_mm", (self.nearest_mm, self.farthest_mm), "0 < nearest < farthest")


@dataclass(frozen=True, kw_only=True, eq=False)
class Demodulation:
    """What is left of an image after the carrier is taken out; every array is (height, width)."""

    fraction: NDArray[np.float32]
    """Turns of phase, less their unknown whole number, from 0 to 1."""
    amplitude: NDArray[np.float32]
    """Amplitude of the stripes in grey values."""
    contrast: NDArray[np.float32]
    """Amplitude relative to the local mean."""
    residual: NDArray[np.float32]
    """Misfit of the fitted wave relative to its amplitude, root mean square over the window."""


class PhaseEstimator:
    """Demodulates each row with a Gaussian-windowed carrier (a Gabor filter) and triangulates.

    The window is symmetric, so that a phase that is linear within it, as a tilted plane nearly gives, is read without bias.
    """

    def __init__(self, rig: Rig, config: PhaseConfig | None = None) -> None:
        self.rig = rig
        self.config = config or PhaseConfig()
        camera = self.rig.camera
        self._carrier = StripeCarrier(rig=self.rig)
        period = self._carrier.period_px
        window = gaussian_matrix(camera.width, self.config.window_periods * period)
        self._wave = np.exp(1j * self._carrier.angle).astype(np.complex64)
        # Row vectors times these matrices: smoothing along x, and demodulation in one product.
        self._window_x = np.ascontiguousarray(window.T, dtype=np.float32)
        self._mean_x = np.ascontiguousarray(gaussian_matrix(camera.width, 0.8 * period).T, dtype=np.float32)
        self._mean_y = gaussian_matrix(camera.height, 3.0).astype(np.float32)
        self._support_y = gaussian_matrix(camera.height, self.config.support_px).astype(np.float32)

    def demodulate(self, image: NDArray[np.uint8]) -> Demodulation:
        """Take the carrier out of an image (height, width)."""
        grey = image.astype(np.float32)
        mean = self._mean_y @ grey @ self._mean_x + np.float32(1.0)
        # Dividing by the local mean first keeps shading and albedo from bending the phase.
        normal = grey / mean - np.float32(1.0)
        base = normal * self._wave.conj()
        wave = np.float32(2.0) * (self._support_y @ (base.real @ self._window_x + 1j * (base.imag @ self._window_x)))
        contrast = np.abs(wave)
        misfit = (normal - (wave * self._wave).real) ** 2
        spread = np.sqrt(self._support_y @ misfit @ self._window_x)
        fraction = np.mod(-np.angle(wave) / (2.0 * np.pi), 1.0)
        return Demodulation(
            fraction=fraction.astype(np.float32),
            amplitude=(contrast * mean).astype(np.float32),
            contrast=contrast.astype(np.float32),
            residual=(spread / (contrast + np.float32(1e-6))).astype(np.float32),
        )

    def estimate(self, image: NDArray[np.uint8]) -> DepthEstimate:
        """Estimate z-depth in millimetres and its validity from an image (height, width); see `DepthEstimator`."""
        check_image(image, self.rig)
        config = self.config
        seen = self.demodulate(image)
        farthest_turns = self._carrier.turns_metre / (1e-3 * config.nearest_mm) - 1.0
        turns = farthest_turns + np.mod(seen.fraction - farthest_turns, 1.0)
        # Where the turn ends beyond infinity some phases have no depth: such pixels are put at twice the farthest.
        depth_mm = 1e3 * self._carrier.turns_metre / np.maximum(turns, 0.5e3 * self._carrier.turns_metre / config.farthest_mm)
        mm_per_turn = 1e-3 * depth_mm**2 / self._carrier.turns_metre
        valid = (
            (seen.amplitude >= config.min_amplitude)
            & (seen.contrast >= config.min_contrast)
            & (seen.residual <= config.max_residual)
            & (depth_mm <= config.farthest_mm)
            & (image < config.saturated)
            & (seen.residual * mm_per_turn <= 2.0 * np.pi * config.max_misfit_mm)
            & (_steepest_step(turns) * mm_per_turn <= config.max_slope_mm)
            & self._window_inside(turns)
        )
        return DepthEstimate(depth_mm=depth_mm.astype(np.float32), valid=valid)

    def _window_inside(self, turns: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return where enough of the window lies inside the image and on the lit part of the mask."""
        margin, mask, camera_x = self.config.margin_periods, self.rig.mask, self.rig.camera.rays[..., 0]
        half_image = 0.5 * self.rig.camera.width / self.rig.camera.fx
        half_mask = mask.half_width_tan - margin * mask.period_tan
        mask_x = camera_x - mask.period_tan * turns
        inside: NDArray[np.bool_] = (np.abs(mask_x) <= half_mask) & (np.abs(camera_x) <= half_image - margin * mask.period_tan)
        return inside


def _steepest_step(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the largest absolute difference to the four neighbours, same shape."""
    steepest = np.zeros_like(values)
    across = np.abs(np.diff(values, axis=1))
    along = np.abs(np.diff(values, axis=0))
    for part, step in ((steepest[:, 1:], across), (steepest[:, :-1], across), (steepest[1:], along), (steepest[:-1], along)):
        np.maximum(part, step, out=part)
    return steepest
