"""Organs as the beam meets them: how bright they are and how they spread light, by published measurements."""

from dataclasses import dataclass, replace
from typing import Literal

from laploop.assets.ranges import Span
from laploop.envs.sensors.optics.stripe_optics import TISSUE, Material, StripeOptics
from laploop.envs.sensors.optics.subsurface import Subsurface, absorption_of
from laploop.errors import InvalidValueError, UnknownNameError

_REFERENCE_M = 500e-9

TissueClassName = Literal["bowel", "stomach", "liver", "fat"]


@dataclass(frozen=True, kw_only=True)
class TissueClass:
    """Optics of one kind of tissue.

    Scattering is a power law, mu_s' = a (wavelength / 500 nm)^-b, with the numbers of Jacques (Optical properties of biological
    tissues: a review, Phys Med Biol 58 R37, 2013), table 1. The albedo is what endoscopes see in green light, and absorption
    follows from both, so that a medium cannot be brighter than its blood allows. The anisotropy, about 0.9 in soft tissue, is
    part of mu_s' and has no effect of its own on the spot.
    """

    scattering_per_m: float
    """a, mu_s' at 500 nm."""
    scattering_power: float
    """b."""
    albedo: Span[float]
    """Diffuse reflectance of healthy tissue, 520 to 620 nm."""
    refractive_index: float = 1.37

    def subsurface(self, albedo: float, wavelength_m: float) -> Subsurface:
        """Return how the tissue spreads light of a wavelength where it has that albedo.

        Raises:
            InvalidValueError: If no absorption gives that albedo.
        """
        scattering = self.scattering_per_m * (wavelength_m / _REFERENCE_M) ** -self.scattering_power
        return Subsurface(
            profile="dipole",
            reduced_scattering_per_m=scattering,
            absorption_per_m=absorption_of(albedo, scattering, self.refractive_index),
            refractive_index=self.refractive_index,
        )


TISSUE_CLASSES: dict[str, TissueClass] = {
    "bowel": TissueClass(scattering_per_m=1650.0, scattering_power=1.24, albedo=(0.3, 0.5)),
    "stomach": TissueClass(scattering_per_m=1910.0, scattering_power=0.97, albedo=(0.3, 0.5)),
    "liver": TissueClass(scattering_per_m=900.0, scattering_power=0.617, albedo=(0.05, 0.15)),
    "fat": TissueClass(scattering_per_m=1410.0, scattering_power=0.53, albedo=(0.5, 0.7)),
}
"""Scattering of bowel, stomach wall and adipose tissue after Alexandrakis et al. (2005), of liver after Parsa et al. (1989)."""


def tissue_material(
    name: str, *, albedo: float | None = None, surface: Material = TISSUE, wavelength_m: float = StripeOptics.wavelength_m
) -> Material:
    """Return the material of a tissue class; without an albedo, that in the middle of its range.

    Args:
        name: One of `TISSUE_CLASSES`.
        albedo: Diffuse reflectance.
        surface: Its gloss; by default that of wet tissue.
        wavelength_m: Of the light.

    Raises:
        UnknownNameError: If there is no such class.
        InvalidValueError: If the albedo is outside of the class's range.
    """
    if name not in TISSUE_CLASSES:
        raise UnknownNameError("tissue class", name, TISSUE_CLASSES)
    tissue = TISSUE_CLASSES[name]
    low, high = tissue.albedo
    chosen = 0.5 * (low + high) if albedo is None else albedo
    if not low <= chosen <= high:
        raise InvalidValueError(f"albedo of {name}", chosen, f"{low:g} to {high:g}")
    return replace(surface, albedo=chosen, subsurface=tissue.subsurface(chosen, wavelength_m))
