"""The surface of a grown phantom: folded, gut-like lobes as a seeded height field.

Coils come from the Swift-Hohenberg equation, whose steady patterns are labyrinths of bands of nearly equal width that
meander, branch and end as packed loops of bowel do; a round cross-section over each band gives lobes with creases between
them.
"""

import numpy as np
from scipy import fft, ndimage

from laploop.arrays import Array
from laploop.assets.tissue_config import PATTERN_SIZE, TissueShape


def height_field(shape: TissueShape, rng: np.random.Generator) -> Array:
    """Grow one tissue: heights (samples, samples) in metres above the bottom, indexed [x, y]."""
    wave = rng.uniform(shape.lobe_width_min_m, shape.lobe_width_max_m)
    pitch = shape.spacing_m
    lobes = _lobes(_labyrinth(rng, wave / pitch), wave / pitch)
    undulation = _band_noise(rng, 0.09 / pitch)
    # Haustra: shallow bulges along the coils.
    bulges = _band_noise(rng, 0.016 / pitch)
    corner = rng.integers(0, PATTERN_SIZE - shape.samples + 1, size=2)
    window = tuple(slice(int(start), int(start) + shape.samples) for start in corner)
    lobes, undulation, bulges = lobes[window], undulation[window], bulges[window]
    lobes = _with_ridges(shape, lobes, rng)
    height = shape.lobe_height_m * lobes * (1.0 + 0.06 * undulation) + 0.0022 * undulation + 0.0009 * bulges
    # Rounds creases and the flanks of ridges to the curvature of tissue about 2 mm thick, which the mesh can resolve.
    height = ndimage.gaussian_filter(height, 0.0014 / pitch, mode="nearest")
    height *= min(1.0, (shape.height_m - shape.floor_m) / float(np.ptp(height)))
    height += shape.height_m - height.max()
    return np.asarray(height * _rounded_border(shape), dtype=np.float64)


def _labyrinth(rng: np.random.Generator, wave: float) -> Array:
    """Evolve du/dt = eps u - (1 + laplacian)^2 u - u^3 from noise, semi-implicitly; `wave` is in samples."""
    n, eps, step = PATTERN_SIZE, 0.3, 0.5
    k_squared = _wave_numbers_squared() * (wave / (2.0 * np.pi)) ** 2
    linear = 1.0 / (1.0 - step * (eps - (1.0 - k_squared) ** 2))
    field = _band_noise(rng, wave) * 0.4
    # A product: the power function takes a hundred times as long.
    for _ in range(120):
        field = fft.irfft2(linear * fft.rfft2(field - step * (field * field * field)), s=(n, n))
    return np.asarray(field)


def _lobes(pattern: Array, wave: float) -> Array:
    """Turn the pattern into lobes of round cross-section: 0 in the creases, 1 on the crests."""
    envelope = np.sqrt(2.0 * ndimage.gaussian_filter(pattern**2, 0.5 * wave, mode="wrap"))
    # Where the pattern is a plane wave, this is the distance from the crest in half wavelengths.
    distance = np.arccos(np.clip(pattern / envelope, -1.0, 1.0)) / np.pi
    # An ellipse cut off at 0.8 of its half width, so that the flank keeps a finite slope in the crease.
    cut = 0.8
    lowest = np.sqrt(1.0 - cut**2)
    return np.asarray((np.sqrt(1.0 - (cut * distance) ** 2) - lowest) / (1.0 - lowest))


def _with_ridges(shape: TissueShape, lobes: Array, rng: np.random.Generator) -> Array:
    """Lay narrow bands across the creases, below the crests, blended by a smooth maximum."""
    line = np.linspace(-0.5 * shape.side_m, 0.5 * shape.side_m, shape.samples)
    x, y = np.meshgrid(line, line, indexing="ij")
    softness = 0.06
    result = lobes
    for _ in range(shape.ridges):
        centre = rng.uniform(-0.42 * shape.side_m, 0.42 * shape.side_m, size=2)
        angle, half_length = rng.uniform(0.0, np.pi), rng.uniform(0.010, 0.020)
        width, top, bend = rng.uniform(0.0025, 0.004), rng.uniform(0.55, 0.8), rng.uniform(-12.0, 12.0)
        along = (x - centre[0]) * np.cos(angle) + (y - centre[1]) * np.sin(angle)
        across = -(x - centre[0]) * np.sin(angle) + (y - centre[1]) * np.cos(angle) - bend * along**2
        overshoot = np.maximum(np.abs(along) - half_length, 0.0)
        band = top * np.exp(-0.5 * (across**2 + overshoot**2) / width**2)
        result = 0.5 * (result + band + np.sqrt((result - band) ** 2 + softness**2)) - 0.5 * softness
    return np.asarray(result)


def _rounded_border(shape: TissueShape) -> Array:
    """Return a factor (samples, samples) that rounds the tissue off towards its four sides in a quarter of an ellipse."""
    line = np.linspace(0.0, shape.side_m, shape.samples)
    margin = 0.012
    inside = np.clip(np.minimum(line, shape.side_m - line) / margin, 0.0, 1.0)
    lowest = 0.45
    profile = lowest + (1.0 - lowest) * np.sqrt(1.0 - (1.0 - inside) ** 2)
    return np.asarray(np.minimum(profile[:, None], profile[None, :]))


def _band_noise(rng: np.random.Generator, wave: float) -> Array:
    """Return periodic noise of one wavelength (in samples) and unit standard deviation."""
    n = PATTERN_SIZE
    k = np.sqrt(_wave_numbers_squared()) * (wave / (2.0 * np.pi))
    spectrum = fft.rfft2(rng.standard_normal((n, n))) * np.exp(-(((k - 1.0) / 0.25) ** 2))
    spectrum[0, 0] = 0.0
    noise = fft.irfft2(spectrum, s=(n, n))
    return np.asarray(noise / noise.std())


def _wave_numbers_squared() -> Array:
    """Return |k|^2 on the half spectrum of the pattern's square, in radians per sample."""
    kx = 2.0 * np.pi * fft.fftfreq(PATTERN_SIZE)
    ky = 2.0 * np.pi * fft.rfftfreq(PATTERN_SIZE)
    return np.asarray(kx[:, None] ** 2 + ky[None, :] ** 2)
