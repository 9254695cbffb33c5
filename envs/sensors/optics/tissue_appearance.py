"""What the surface of a tissue looks like beside its smooth texture: dark patches as of blood, and finer detail.

All of it is a factor on the albedo at the tissue's vertices, so that it moves and stretches with the tissue. Details finer than
about two edges of the tissue's mesh are smoothed away by the interpolation between vertices.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from laploop.envs.sensors.optics.presets import Range
from laploop.errors import InvalidValueError, check_range

Array = NDArray[np.float64]

_WAVES = 48
_PATCH_BAND = (1.0, 2.5)
"""Wavelengths of the field that patches are cut from, in patch sizes."""
_SOFT = 0.8
"""Width of a patch's border, in standard deviations of that field: about 3 mm for patches of the default size, an edge or so of
the tissue's mesh; sharper borders would show its triangles."""
_FINE_WAVELENGTHS_M = (0.004, 0.010)
_DARKEST = 0.02


@dataclass(frozen=True, kw_only=True)
class TissueAppearance:
    """Dark patches and fine texture; the defaults have neither."""

    coverage: float = 0.0
    """Share of the tissue's surface under patches, to the middle of their soft borders."""
    darkness: float = 0.6
    """Share of the albedo that a patch takes away. Blood absorbs most of green light; how much of the albedo a film of it takes
    depends on its thickness, and this number is our choice."""
    patch_size_m: float = 0.012
    """Typical width of a patch."""
    detail: float = 0.0
    """Standard deviation of an additional texture of 4 to 10 mm wavelength, relative to the albedo, as of vessels and fat."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a field lies outside its range.
        """
        check_range("coverage", self.coverage, 0.0, 0.9)
        check_range("darkness", self.darkness, 0.0, 0.95)
        check_range("patch_size_m", self.patch_size_m, 0.002, 0.2)
        check_range("detail", self.detail, 0.0, 0.3)

    @property
    def is_plain(self) -> bool:
        """Whether it changes nothing."""
        return self.detail == 0.0 and (self.coverage == 0.0 or self.darkness == 0.0)


@dataclass(frozen=True, kw_only=True)
class AppearanceRanges:
    """Ranges that appearances are drawn from evenly; all are our choice, for a field with little to a sixth of blood."""

    coverage: Range = (0.0, 0.16)
    darkness: Range = (0.3, 0.8)
    patch_size_m: Range = (0.006, 0.020)
    detail: Range = (0.0, 0.10)

    def __post_init__(self) -> None:
        """Check that no range is empty; the appearance checks the rest when it is drawn.

        Raises:
            InvalidValueError: If one is.
        """
        for name in ("coverage", "darkness", "patch_size_m", "detail"):
            low, high = getattr(self, name)
            if not low <= high:
                raise InvalidValueError(name, (low, high), "low <= high")


def draw_appearance(rng: np.random.Generator, ranges: AppearanceRanges | None = None) -> TissueAppearance:
    """Draw how bloody and how textured a tissue is."""
    ranges = ranges or AppearanceRanges()
    return TissueAppearance(
        coverage=rng.uniform(*ranges.coverage),
        darkness=rng.uniform(*ranges.darkness),
        patch_size_m=rng.uniform(*ranges.patch_size_m),
        detail=rng.uniform(*ranges.detail),
    )


def appearance_factor(
    points_at_rest: NDArray[np.floating], appearance: TissueAppearance, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Make the seeded factor on the albedo at points of a tissue, (n, 3) in metres.

    Patches are where a smooth random field exceeds the threshold that leaves the wanted share of the points above it. As many
    numbers are drawn whatever the appearance is, so that patches stay where they are when they get darker.
    """
    points = np.asarray(points_at_rest, dtype=np.float64)
    size = appearance.patch_size_m
    field = _field(points, (_PATCH_BAND[0] * size, _PATCH_BAND[1] * size), rng)
    fine = _field(points, _FINE_WAVELENGTHS_M, rng)
    factor = 1.0 + appearance.detail * fine
    if appearance.coverage > 0.0:
        threshold = np.quantile(field, 1.0 - appearance.coverage)
        inside = np.clip((field - threshold) / _SOFT + 0.5, 0.0, 1.0)
        factor *= 1.0 - appearance.darkness * inside * inside * (3.0 - 2.0 * inside)
    return np.clip(factor, _DARKEST, 2.0).astype(np.float32)


def _field(points: Array, wavelengths_m: Range, rng: np.random.Generator) -> Array:
    """Return a sum of plane waves at points (n, 3), close to Gaussian with mean 0 and standard deviation 1."""
    direction = rng.standard_normal((_WAVES, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    wavelength = np.exp(rng.uniform(np.log(wavelengths_m[0]), np.log(wavelengths_m[1]), _WAVES))
    phase = rng.uniform(0.0, 2.0 * np.pi, _WAVES)
    waves = np.cos(2.0 * np.pi * points @ (direction / wavelength[:, None]).T + phase)
    return np.asarray(np.sqrt(2.0 / _WAVES) * waves.sum(axis=1))
