"""What light, surfaces and sensor of anatomy scenes are drawn from."""

import math
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from laploop.assets.ranges import Span, check_ordered
from laploop.configuration import Field, configuration
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.optics.presets import Light, OpticsRanges, draw_light, randomised_surfaces
from laploop.envs.sensors.optics.stripe_optics import Fraction, Material, Roughness, StripeOptics
from laploop.envs.sensors.optics.tissue_classes import TISSUE_CLASSES, tissue_material
from laploop.envs.sensors.stripe_capture import StripeCapture
from laploop.errors import InvalidValueError
from laploop.studies.scenes.light_variety import draw_response, draw_subsurface

_ORGAN_ALBEDOS: tuple[Span[float], ...] = ((0.05, 0.15), (0.3, 0.5), (0.5, 0.7), (0.05, 0.7))
"""Diffuse reflectance in green light of liver, of serosa, of fat, and of anything between; each for a quarter of the scenes."""
_WET_ROUGHNESS, _BARE_ROUGHNESS = (0.06, 0.20), (0.30, 0.70)
_WET_REFLECTANCE, _BARE_REFLECTANCE = (0.020, 0.030), (0.0, 0.020)
"""Of a water film (n = 1.33 to 1.38), and of a surface that has dried or is powdered."""
_FILM_ROUGHNESS = (0.03, 0.10)
"""Of liquid that stands on tissue: smoother than the tissue below."""
_EXPOSED_PERCENTILE = 95.0
_BRIGHTEST_ALBEDO = 0.9

Distance = Annotated[float, Field(ge=0.03, le=0.3)]
Level = Annotated[float, Field(ge=0.05, le=1.5)]


@configuration
class AnatomyRanges(OpticsRanges):
    """Ranges of anatomy scenes, drawn from evenly unless stated otherwise; the tissue's own are drawn by kinds of organ."""

    light: Span[Light] = (0.3, 2.2)
    tissue_albedo: Span[Fraction] = (0.05, 0.7)
    """Bounds on what the kinds of organ give."""
    tissue_roughness: Span[Roughness] = (0.06, 0.7)
    """Bounds on what wet and bare surfaces give."""
    cavity_fraction: Span[Fraction] = (0.02, 0.40)
    """Irradiance by light that went astray in the cavity, relative to the exitance."""
    tissue_class_fraction: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Fraction of the scenes whose tissue is one of `TISSUE_CLASSES`, so that its spread of light and its albedo belong
    together; in the others both are drawn for themselves."""
    working_distance_m: Span[Distance] = (0.060, 0.140)
    """From the camera to the point of the organ that it looks at."""
    usual_distance_m: Span[Distance] = (0.070, 0.110)
    """Half of the frames are taken from this range, in which the loop works."""
    far_distance_m: Span[Distance] = (0.140, 0.200)
    """Beyond the range of the loop, where networks must learn to mark pixels invalid."""
    far_fraction: Annotated[float, Field(ge=0.0, le=1.0)] = 0.06
    """Of the frames, those taken from afar."""
    tilt_rad: Annotated[float, Field(ge=0.0, le=1.2)] = math.radians(45.0)
    """Largest angle between the camera's axis and the vertical."""
    auto_exposure_fraction: Annotated[float, Field(ge=0.0, le=1.0)] = 0.8
    """Of the frames, those whose light brings the bright stripes to a level drawn from `exposure_level`. In half of the others
    the light is multiplied by the squared distance; in the rest it is what was drawn."""
    exposure_level: Span[Level] = (0.25, 1.0)
    """95th percentile of the expected image, as a fraction of full scale."""

    def __post_init__(self) -> None:
        check_ordered(self)
        if self.far_fraction > 0.0 and self.far_distance_m[0] < self.working_distance_m[0]:
            raise InvalidValueError("far_distance_m", self.far_distance_m, f"from {self.working_distance_m[0]:g} on")


@dataclass(frozen=True, kw_only=True)
class AnatomyMaterials:
    """Materials of one scene."""

    tissue: Material
    film: Material
    """Of places under liquid: the tissue's albedo below a smoother surface."""

    @property
    def largest_factor(self) -> float:
        """Factor on the albedo that makes the tissue as bright as anything in a body."""
        return _BRIGHTEST_ALBEDO / self.tissue.albedo


def draw_materials(ranges: AnatomyRanges, rng: np.random.Generator) -> AnatomyMaterials:
    """Draw what a scene's tissue is: liver, serosa, fat or anything between, wet or bare."""
    albedo = rng.uniform(*_ORGAN_ALBEDOS[rng.integers(len(_ORGAN_ALBEDOS))])
    wet = rng.random() < 0.6
    roughness = rng.uniform(*(_WET_ROUGHNESS if wet else _BARE_ROUGHNESS))
    tissue = Material(
        albedo=float(np.clip(albedo, *ranges.tissue_albedo)),
        reflectance=rng.uniform(*(_WET_REFLECTANCE if wet else _BARE_REFLECTANCE)),
        roughness=float(np.clip(roughness, *ranges.tissue_roughness)),
        subsurface=draw_subsurface(ranges.subsurface_fwhm_m, rng),
    )
    # An option that is off draws no numbers, so that the scenes of a seed do not depend on it.
    if ranges.tissue_class_fraction > 0.0 and rng.random() < ranges.tissue_class_fraction:
        name = sorted(TISSUE_CLASSES)[rng.integers(len(TISSUE_CLASSES))]
        tissue = tissue_material(name, albedo=rng.uniform(*TISSUE_CLASSES[name].albedo), surface=tissue)
    film = replace(tissue, reflectance=rng.uniform(*_WET_REFLECTANCE), roughness=rng.uniform(*_FILM_ROUGHNESS))
    return AnatomyMaterials(tissue=tissue, film=film)


def draw_anatomy_optics(
    ranges: AnatomyRanges, materials: AnatomyMaterials, distance_m: float, rng: np.random.Generator
) -> StripeOptics:
    """Draw light, instrument's surface and sensor of one frame."""
    nominal = StripeOptics()
    light = draw_light(rng, ranges)
    if rng.random() < 0.5:
        light *= (distance_m / 0.085) ** 2
    optics = randomised_surfaces(replace(nominal, led_power_w=nominal.led_power_w * light), rng, ranges)
    return replace(optics, tissue=materials.tissue, other=materials.film, response=draw_response(rng))


def auto_exposed(capture: StripeCapture, optics: StripeOptics, level: float) -> StripeOptics:
    """Return the optics with the light that a settled automatic exposure gives.

    It looks at the scene and not at an instrument, which shines when it comes close, as operators set the metered field.

    Args:
        capture: Taken with `optics`; its electrons are proportional to the power.
        optics: What to change.
        level: 95th percentile that the scene's signal should have, as a fraction of full scale.
    """
    scene = capture.electrons[capture.object_id != int(ObjectId.TOOL)]
    if scene.size == 0:
        return optics
    found = float(np.percentile(scene, _EXPOSED_PERCENTILE)) / optics.full_well_electrons
    return replace(optics, led_power_w=min(10.0, optics.led_power_w * optics.response.signal(level) / max(found, 1e-4)))
