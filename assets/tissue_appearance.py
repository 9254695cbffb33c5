"""What a tissue's surface looks like: a smooth texture, dark patches as of blood, and finer detail.

All of it is a factor on the albedo at the tissue's vertices, so that it moves and stretches with the tissue. Details finer than
about two edges of the tissue's mesh are smoothed away by the interpolation between vertices.
"""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from laploop.arrays import Array
from laploop.assets.ranges import Span, check_ordered
from laploop.configuration import Field, configuration

_TEXTURE_WAVES = 32
_TEXTURE_WAVELENGTHS_M = (0.008, 0.05)
_TEXTURE_STD = 0.12
_WAVES = 48
_PATCH_BAND = (1.0, 2.5)
"""Wavelengths of the field that patches are cut from, in patch sizes."""
_SOFT = 0.8
"""Width of a patch's border, in standard deviations of that field: about 3 mm for patches of the default size, an edge or so of
the tissue's mesh; sharper borders would show its triangles."""
_FINE_WAVELENGTHS_M = (0.004, 0.010)
_DARKEST = 0.02

Coverage = Annotated[float, Field(ge=0.0, le=0.9)]
Darkness = Annotated[float, Field(ge=0.0, le=0.95)]
PatchSize = Annotated[float, Field(ge=0.002, le=0.2)]
Detail = Annotated[float, Field(ge=0.0, le=0.3)]


@configuration
class TissueAppearance:
    """Dark patches and fine texture; the defaults have neither."""

    coverage: Coverage = 0.0
    """Fraction of the tissue's surface under patches, to the middle of their soft borders."""
    darkness: Darkness = 0.6
    """Fraction of the albedo that a patch takes away. Blood absorbs most of green light; the effect of a film depends on its
    thickness, and the default is our choice."""
    patch_size_m: PatchSize = 0.012
    """Typical width of a patch."""
    detail: Detail = 0.0
    """Standard deviation of an additional texture of 4 to 10 mm wavelength, relative to the albedo, as of vessels and fat."""

    @property
    def is_plain(self) -> bool:
        """Whether it changes nothing."""
        return self.detail == 0.0 and (self.coverage == 0.0 or self.darkness == 0.0)


@configuration
class AppearanceRanges:
    """Ranges that appearances are drawn from evenly; our choice, for a field with no blood to a sixth of it."""

    coverage: Span[Coverage] = (0.0, 0.16)
    """Fraction of the surface that patches cover."""
    darkness: Span[Darkness] = (0.3, 0.8)
    """Fraction of the albedo that a patch takes away."""
    patch_size_m: Span[PatchSize] = (0.006, 0.020)
    """Size of a patch."""
    detail: Span[Detail] = (0.0, 0.10)
    """Standard deviation of the additional texture, relative to the albedo."""

    def __post_init__(self) -> None:
        check_ordered(self)


def draw_appearance(rng: np.random.Generator, ranges: AppearanceRanges) -> TissueAppearance:
    """Draw how bloody and how textured a tissue is."""
    return TissueAppearance(
        coverage=rng.uniform(*ranges.coverage),
        darkness=rng.uniform(*ranges.darkness),
        patch_size_m=rng.uniform(*ranges.patch_size_m),
        detail=rng.uniform(*ranges.detail),
    )


def tissue_albedo(
    points_at_rest: NDArray[np.floating], appearance: TissueAppearance, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Return the seeded factor on the albedo, (n,), at points of a tissue, (n, 3) in metres."""
    factor = _texture(points_at_rest, rng)
    return factor if appearance.is_plain else factor * appearance_factor(points_at_rest, appearance, rng)


def appearance_factor(
    points_at_rest: NDArray[np.floating], appearance: TissueAppearance, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Make the seeded albedo factor of patches and detail, (n,), at points of a tissue, (n, 3) in metres.

    Patches are where a smooth random field exceeds the threshold that leaves the given fraction of the points above it. The
    number of draws does not depend on the appearance, so that patches stay in place when they get darker.
    """
    size = appearance.patch_size_m
    field = gaussian_field(points_at_rest, (_PATCH_BAND[0] * size, _PATCH_BAND[1] * size), rng)
    fine = gaussian_field(points_at_rest, _FINE_WAVELENGTHS_M, rng)
    factor = 1.0 + appearance.detail * fine
    if appearance.coverage > 0.0:
        threshold = np.quantile(field, 1.0 - appearance.coverage)
        inside = np.clip((field - threshold) / _SOFT + 0.5, 0.0, 1.0)
        factor *= 1.0 - appearance.darkness * inside * inside * (3.0 - 2.0 * inside)
    return np.clip(factor, _DARKEST, 2.0).astype(np.float32)


def _texture(points_at_rest: NDArray[np.floating], rng: np.random.Generator) -> NDArray[np.float32]:
    """Make a smooth, seeded albedo factor around 1, (n,), for points of a tissue, (n, 3) in metres.

    A sum of plane waves with random directions, phases and wavelengths from 8 to 50 mm, longer ones stronger.
    """
    waves, wavelength = plane_waves(points_at_rest, _TEXTURE_WAVELENGTHS_M, _TEXTURE_WAVES, rng)
    weight = np.sqrt(wavelength / np.sum(wavelength) * 2.0) * _TEXTURE_STD
    factor: Array = np.clip(1.0 + waves @ weight, 0.5, 1.5)
    return factor.astype(np.float32)


def gaussian_field(points: NDArray[np.floating], wavelengths_m: Span[float], rng: np.random.Generator) -> Array:
    """Return a sum of plane waves at points (n, 3), close to Gaussian with mean 0 and standard deviation 1."""
    waves, _ = plane_waves(points, wavelengths_m, _WAVES, rng)
    return np.asarray(np.sqrt(2.0 / _WAVES) * waves.sum(axis=1))


def plane_waves(
    points: NDArray[np.floating], wavelengths_m: Span[float], count: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Return plane waves of random direction and phase at points (n, 3), (n, count), and their wavelengths, (count,)."""
    direction = rng.standard_normal((count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    wavelength = np.exp(rng.uniform(np.log(wavelengths_m[0]), np.log(wavelengths_m[1]), count))
    phase = rng.uniform(0.0, 2.0 * np.pi, count)
    points = np.asarray(points, dtype=np.float64)
    return np.cos(2.0 * np.pi * points @ (direction / wavelength[:, None]).T + phase), wavelength
