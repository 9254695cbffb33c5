"""Which scope is characterised, at which distances."""

from dataclasses import field, replace
from pathlib import Path
from typing import Annotated, Literal

from laploop.assets.mask_fabrication import fabricated
from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.configuration import Field, Seed, configuration
from laploop.envs.sensors.optics.presets import PresetName

FIGURE_DISTANCES_MM = (70, 100)
"""Those whose images and profiles are shown."""

Distance = Annotated[int, Field(ge=50, le=300)]
"""Nearer, the target reaches out of the light."""


@configuration
class CharacterizationConfig:
    """Which scope looks at which distances."""

    preset: PresetName = "paper"
    """Optical model."""
    distances_mm: tuple[Distance, ...] = tuple(range(50, 151, 10))
    """From the camera to the middle mark; 70 and 100 mm are always measured."""
    seed: Seed = 0
    """Of the sensor's noise."""
    optics: ScopeOptics = field(default_factory=ScopeOptics)

    @property
    def measured_mm(self) -> tuple[int, ...]:
        """All distances that are measured, nearest first."""
        return tuple(sorted({*self.distances_mm, *FIGURE_DISTANCES_MM}))

    def with_mask(self, image: Path | None, route: Literal["printed", "chrome"] | None) -> "CharacterizationConfig":
        """Return the configuration with another mask.

        Args:
            image: A grey PNG of a mask, in place of the built-in one; see `StripeMask.from_png`.
            route: How the mask was made, which decides how rough the edges of its stripes are.

        Raises:
            MissingFileError: If there is no such image.
            InvalidValueError: If it cannot be read, or shows edges of its own and a route is given.
        """
        mask = self.optics.mask
        if image is not None:
            mask = StripeMask.from_png(image, stripes=mask.stripes, fov_rad=mask.fov_rad, edge_roughness=mask.edge_roughness)
        if route is not None:
            mask = fabricated(mask, route, mask.edge_seed)
        return replace(self, optics=replace(self.optics, mask=mask))
