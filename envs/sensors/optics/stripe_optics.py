"""The optical and electronic model of the stripe camera, as numbers."""

import functools
import math
from dataclasses import field
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from laploop.assets.stripe_mask import StripeMask
from laploop.configuration import Field, configuration
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.optics.camera_response import CameraResponse
from laploop.envs.sensors.optics.exposure_control import ExposureControl
from laploop.envs.sensors.optics.projection_blur import ProjectionBlur
from laploop.envs.sensors.optics.subsurface import Subsurface
from laploop.perception.reprojection import BrownDistortion

_PLANCK_TIMES_LIGHT_SPEED_J_M = 6.62607015e-34 * 299792458.0


Fraction = Annotated[float, Field(ge=0.0, le=1.0)]
Roughness = Annotated[float, Field(ge=0.02, le=1.0)]
SourceBlur = Annotated[float, Field(ge=0.0, le=0.04)]
LensBlur = Annotated[float, Field(ge=0.0, le=10.0)]
FullWell = Annotated[float, Field(ge=100.0, le=1e6)]
ReadNoise = Annotated[float, Field(ge=0.0, le=1000.0)]
Exponent = Annotated[float, Field(ge=0.0, le=8.0)]
Ambient = Annotated[float, Field(ge=0.0, le=1000.0)]


@configuration
class Material:
    """How a surface scatters light: Lambert plus GGX, and a spread of the Lambertian part under the surface."""

    albedo: Fraction
    """Diffuse reflectance at the LED's wavelength; multiplied by the scene's own factor at each vertex."""
    reflectance: Fraction
    """Specular reflectance at normal incidence (Fresnel's F0)."""
    roughness: Roughness
    """GGX width alpha."""
    subsurface: Subsurface = field(default_factory=Subsurface)
    """Where light that enters the surface leaves it; by default where it enters."""


TISSUE = Material(albedo=0.4, reflectance=0.025, roughness=0.2, subsurface=Subsurface(profile="gaussian"))
"""Bowel serosa: albedo 0.3 to 0.5, water film (n = 1.37: F0 = 2.4 %), roughness 0.1 to 0.25, subsurface spot about 1 mm."""
TOOL = Material(albedo=0.12, reflectance=0.5, roughness=0.35)
"""Brushed steel."""
STAGE = Material(albedo=0.1, reflectance=0.03, roughness=0.6)
"""Dark anodised plate."""
OTHER = Material(albedo=0.4, reflectance=0.0, roughness=0.6)
"""A matte target without scattering under its surface, such as a printed card."""


@configuration
class StripeOptics:
    """Light source, projection, lens, surfaces and sensor of the stripe camera.

    The chain from the LED to the electrons is radiometric: the intensity that leaves the projector, irradiance by 1/d² and the
    cosine, radiance by the surface's reflectance, irradiance on the sensor by the f-number, electrons by exposure and quantum
    efficiency. The defaults put the bright stripes on a facing tissue plane at 85 mm at about 0.45 of full scale.

    The irradiance of a surface is that of the mask blurred by source and defocus (`ProjectionBlur`), with the shadows that the
    aperture's disk casts, plus two kinds of stray light and that of other lights. Scattering under the surface spreads it, the
    albedo turns it into radiance, and the lens's point spread blurs the whole image.

    Source blur, aperture, focus and glare are not on any data sheet: they are fitted, so that the Michelson contrast of a matte
    facing plane is 0.58 at 70 mm and 0.44 at 100 mm, as measured on the laparoscope that the simulator follows.
    """

    led_power_w: Annotated[float, Field(ge=0.0, le=10.0)] = 0.031
    """Optical power through the mask's whole field if it had no stripes."""
    led_exponent: Exponent = 1.0
    """The intensity falls with the cosine of the angle to the projector's axis to this power (1: Lambertian emitter)."""
    source_blur_tan: SourceBlur = 0.0090
    """Standard deviation of the blur by the finite source and the lenses, tangent units."""
    projector_focus_m: Annotated[float, Field(ge=0.005, le=10.0)] = 0.050
    """Distance at which the mask is imaged sharply."""
    projector_aperture_m: Annotated[float, Field(ge=0.0, le=0.02)] = 0.0033
    """Diameter of the projection lens's aperture."""
    glare_fraction: Fraction = 0.055
    """Fraction of the light through the mask that the projector's optics scatter evenly over its field: it has no pattern, but
    fall-off and shadows like the rest."""
    cavity_fraction: Fraction = 0.10
    """Irradiance of everything by light that went astray between tissue and cavity, relative to the mean radiant exitance of
    what the beam lights and the camera sees."""
    ambient_w_m2: Ambient = 0.0
    """Irradiance of everything by other lights, evenly from all sides, as far as the camera's filter lets it through: a lamp in
    the room, another scope's light. The beam's brightest irradiance at 85 mm is 4.6 W/m²."""
    f_number: Annotated[float, Field(ge=0.7, le=64.0)] = 4.0
    """The lens's focal length over its aperture."""
    lens_transmission: Annotated[float, Field(ge=0.01, le=1.0)] = 0.7
    """Fraction of the light that the lens lets through."""
    vignetting_exponent: Exponent = 4.0
    """The sensor's irradiance falls with the cosine of the angle to the camera's axis to this power; 4 is the natural
    fall-off of a lens without vignetting."""
    lens_blur_px: LensBlur = 0.7
    """Standard deviation of the camera lens's point spread."""
    distortion: BrownDistortion = field(default_factory=BrownDistortion)
    """Distortion of the camera's lens."""
    exposure_s: Annotated[float, Field(ge=1e-6, le=1.0)] = 0.015
    """Exposure time; that of the first image where `exposure_control` changes it."""
    exposure_control: ExposureControl = field(default_factory=ExposureControl)
    """Automatic exposure; by default off."""
    wavelength_m: Annotated[float, Field(ge=350e-9, le=1100e-9)] = 525e-9
    """The LED's."""
    pixel_pitch_m: Annotated[float, Field(ge=0.5e-6, le=50e-6)] = 3.45e-6
    """Side of a sensor's pixel."""
    quantum_efficiency: Annotated[float, Field(ge=0.01, le=1.0)] = 0.62
    """Electrons a photon."""
    full_well_electrons: FullWell = 10500.0
    """Electrons at the output's full scale; the default is that of a Pregius-class sensor."""
    read_noise_electrons: ReadNoise = 2.5
    """Standard deviation of the read noise."""
    response: CameraResponse = field(default_factory=CameraResponse)
    """From charge to grey value; by default linear."""
    bits: Literal[8, 12] = 8
    """Bits of the output."""
    tissue: Material = TISSUE
    tool: Material = TOOL
    stage: Material = STAGE
    other: Material = OTHER

    @cached_property
    def material_table(self) -> NDArray[np.float32]:
        """One row an `ObjectId`: albedo, reflectance at normal incidence, roughness."""
        rows = np.zeros((len(ObjectId), 3), dtype=np.float32)
        rows[:, 2] = 1.0
        for object_id, material in self._materials:
            rows[object_id] = material.albedo, material.reflectance, material.roughness
        return rows

    @cached_property
    def subsurface_table(self) -> NDArray[np.float32]:
        """Weights and standard deviations in metres of the Gaussians of each `ObjectId`, (Gaussians, object ids, 2).

        There are as many as the material with most of them has; what others lack has neither weight nor width.
        """
        spreads = {object_id: material.subsurface.gaussians for object_id, material in self._materials}
        table = np.zeros((max(map(len, spreads.values())), len(ObjectId), 2), dtype=np.float32)
        for object_id, gaussians in spreads.items():
            table[: len(gaussians), object_id] = gaussians
        return table

    @property
    def _materials(self) -> tuple[tuple[ObjectId, Material], ...]:
        return (
            (ObjectId.TISSUE, self.tissue),
            (ObjectId.TOOL, self.tool),
            (ObjectId.STAGE, self.stage),
            (ObjectId.OTHER, self.other),
        )

    @property
    def electrons_per_radiance(self) -> float:
        """Photo-electrons a pixel on the optical axis collects, for a radiance of 1 W/(m² sr)."""
        irradiance = math.pi * self.lens_transmission / (4.0 * self.f_number**2)
        photons_per_joule = self.wavelength_m / _PLANCK_TIMES_LIGHT_SPEED_J_M
        return irradiance * self.pixel_pitch_m**2 * self.exposure_s * self.quantum_efficiency * photons_per_joule

    def axial_intensity_w_sr(self, mask: StripeMask) -> float:
        """Radiant intensity along the projector's axis through a clear part of the mask."""
        return self.led_power_w / _weighted_solid_angle_sr(mask.half_width_tan, self.led_exponent)

    def projection_blur(self, focal_px: float) -> ProjectionBlur:
        """Return the blur of the mask, a pixel's own width included."""
        sigma = math.sqrt(self.source_blur_tan**2 + 1.0 / (12.0 * focal_px**2))
        return ProjectionBlur(sigma_tan=sigma, aperture_m=self.projector_aperture_m, focus_m=self.projector_focus_m)


@functools.lru_cache(maxsize=64)
def _weighted_solid_angle_sr(half_width_tan: float, exponent: float) -> float:
    """Return the solid angle of a square field, weighted with the cosine of the angle to its axis to a power."""
    edges = np.linspace(-half_width_tan, half_width_tan, 201)
    centres = 0.5 * (edges[1:] + edges[:-1])
    square = 1.0 + centres[:, None] ** 2 + centres[None, :] ** 2
    return float(np.sum(square ** (-1.5 - 0.5 * exponent)) * (edges[1] - edges[0]) ** 2)
