"""Named optical models of the stripe camera, and the ranges within which real ones differ."""

import math
from dataclasses import replace
from typing import Annotated, Literal

import numpy as np

from laploop.assets.ranges import Span, check_ordered
from laploop.configuration import Field, configuration
from laploop.envs.sensors.optics.stripe_optics import (
    STAGE,
    TISSUE,
    TOOL,
    Ambient,
    Fraction,
    FullWell,
    LensBlur,
    Material,
    ReadNoise,
    Roughness,
    SourceBlur,
    StripeOptics,
)
from laploop.envs.sensors.optics.subsurface import SpotWidth, Subsurface
from laploop.errors import InvalidValueError, UnknownNameError

Light = Annotated[float, Field(ge=1e-3, le=100.0)]


@configuration
class OpticsRanges:
    """Ranges of light, surfaces, blur and sensor, drawn from evenly unless stated otherwise.

    Albedo of bowel serosa 0.3 to 0.5 with a margin, a water film's reflectance (index 1.33 to 1.38: 2.0 to 2.5 %), its
    roughness 0.1 to 0.25 with a margin, read noise 2 to 8 electrons as of CMOS and older CCD sensors of this class.
    """

    light: Span[Light] = (0.5, 2.2)
    """LED power times exposure relative to the nominal, drawn evenly in its logarithm."""
    tissue_albedo: Span[Fraction] = (0.28, 0.55)
    """Fraction of the light that tissue sends back diffusely."""
    tissue_roughness: Span[Roughness] = (0.10, 0.30)
    """GGX width alpha of wet tissue."""
    tissue_reflectance: Span[Fraction] = (0.020, 0.030)
    """Fresnel reflectance of wet tissue at normal incidence."""
    subsurface_fwhm_m: Span[SpotWidth] = (0.0006, 0.0015)
    """Width of a point of light under the surface, at half its height."""
    tool_albedo: Span[Fraction] = (0.08, 0.20)
    """The instrument's albedo."""
    tool_roughness: Span[Roughness] = (0.25, 0.50)
    """The instrument's GGX width alpha."""
    stage_albedo: Span[Fraction] = (0.06, 0.20)
    """The stage's albedo."""
    glare_fraction: Span[Fraction] = (0.02, 0.10)
    """Fraction of the projector's light that its optics scatter evenly."""
    source_blur_tan: Span[SourceBlur] = (0.0080, 0.0100)
    """Blur of the mask by the source's size, tangent of its angle."""
    lens_blur_px: Span[LensBlur] = (0.5, 1.0)
    """Standard deviation of the lens's point spread."""
    read_noise_electrons: Span[ReadNoise] = (2.0, 8.0)
    """Standard deviation of the read noise."""
    full_well_electrons: Span[FullWell] = (8000.0, 14000.0)
    """Charge at which a pixel is full."""
    cavity_fraction: Span[Fraction] = (0.03, 0.20)
    """Irradiance by light that went astray in the cavity, relative to the exitance."""
    ambient_w_m2: Span[Ambient] = (0.0, 0.0)
    """Irradiance by other lights, W/m²; drawn only where the upper end is not 0, which leaves all other draws as they are."""

    def __post_init__(self) -> None:
        check_ordered(self)


def _ideal() -> StripeOptics:
    """Return optics in which little but geometry shapes the image.

    Full well and light are 57 times those of a real sensor: the same grey values with an eighth of the shot noise.
    """
    gain = 57.0
    nominal = StripeOptics()
    return replace(
        nominal,
        led_power_w=gain * nominal.led_power_w,
        full_well_electrons=gain * nominal.full_well_electrons,
        read_noise_electrons=0.0,
        source_blur_tan=0.001,
        projector_aperture_m=0.0,
        lens_blur_px=0.2,
        glare_fraction=0.0,
        cavity_fraction=0.0,
        tissue=Material(albedo=TISSUE.albedo, reflectance=0.0, roughness=1.0),
        tool=replace(TOOL, reflectance=0.0),
        stage=replace(STAGE, reflectance=0.0),
    )


def _worst() -> StripeOptics:
    """Return optics at the pessimistic ends of what is known: half the light, a small noisy sensor, wet scattering tissue.

    Its glare puts the stripes' contrast on a matte target at the lower end of its uncertainty, 0.05 below that of
    `paper`; more blur as well would put it beyond.
    """
    nominal, ranges = StripeOptics(), OpticsRanges()
    return replace(
        nominal,
        led_power_w=ranges.light[0] * nominal.led_power_w,
        full_well_electrons=6000.0,
        read_noise_electrons=ranges.read_noise_electrons[1],
        glare_fraction=0.13,
        tissue=Material(
            albedo=0.3,
            reflectance=0.025,
            roughness=0.1,
            subsurface=Subsurface(profile="gaussian", fwhm_m=ranges.subsurface_fwhm_m[1]),
        ),
    )


PresetName = Literal["ideal", "paper", "worst"]

PRESETS: dict[PresetName, StripeOptics] = {"ideal": _ideal(), "paper": StripeOptics(), "worst": _worst()}
"""`paper` is the default everywhere: the laparoscope that the simulator follows, with the contrast measured on it."""


def optics_preset(name: str) -> StripeOptics:
    """Return the preset of that name.

    Raises:
        UnknownNameError: If there is none.
    """
    for known, preset in PRESETS.items():
        if known == name:
            return preset
    raise UnknownNameError("optics preset", name, PRESETS)


def preset_name(optics: StripeOptics) -> PresetName:
    """Return the name of a preset.

    Raises:
        InvalidValueError: If the optics are none of the presets.
    """
    for name, preset in PRESETS.items():
        if preset == optics:
            return name
    raise InvalidValueError("loop.optics", "optics of their own", f"one of the presets {', '.join(PRESETS)}")


def draw_light(rng: np.random.Generator, ranges: OpticsRanges) -> float:
    """Draw LED power times exposure, relative to the nominal."""
    return math.exp(rng.uniform(math.log(ranges.light[0]), math.log(ranges.light[1])))


def randomised_surfaces(optics: StripeOptics, rng: np.random.Generator, ranges: OpticsRanges) -> StripeOptics:
    """Draw all but the light; what has no range keeps its value. The order of draws is fixed: data sets depend on it."""
    return replace(
        optics,
        glare_fraction=rng.uniform(*ranges.glare_fraction),
        source_blur_tan=rng.uniform(*ranges.source_blur_tan),
        lens_blur_px=rng.uniform(*ranges.lens_blur_px),
        read_noise_electrons=rng.uniform(*ranges.read_noise_electrons),
        full_well_electrons=rng.uniform(*ranges.full_well_electrons),
        tissue=replace(
            optics.tissue,
            albedo=rng.uniform(*ranges.tissue_albedo),
            reflectance=rng.uniform(*ranges.tissue_reflectance),
            roughness=rng.uniform(*ranges.tissue_roughness),
            subsurface=replace(optics.tissue.subsurface, fwhm_m=rng.uniform(*ranges.subsurface_fwhm_m)),
        ),
        tool=replace(optics.tool, albedo=rng.uniform(*ranges.tool_albedo), roughness=rng.uniform(*ranges.tool_roughness)),
        stage=replace(optics.stage, albedo=rng.uniform(*ranges.stage_albedo)),
        cavity_fraction=rng.uniform(*ranges.cavity_fraction),
        ambient_w_m2=rng.uniform(*ranges.ambient_w_m2) if ranges.ambient_w_m2[1] > 0.0 else optics.ambient_w_m2,
    )
