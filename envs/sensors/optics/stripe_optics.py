"""The optical and electronic model of the stripe camera, as numbers."""

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from laploop.assets.stripe_mask import StripeMask
from laploop.envs.sensors.object_id import ObjectId
from laploop.errors import InvalidValueError, check_range
from laploop.perception.reprojection import BrownDistortion

_PLANCK_TIMES_LIGHT_SPEED_J_M = 6.62607015e-34 * 299792458.0


@dataclass(frozen=True, kw_only=True)
class Material:
    """How a surface scatters light: Lambert plus GGX, and a Gaussian blur under the surface."""

    albedo: float
    """Diffuse reflectance at the LED's wavelength; times the scene's own factor at each vertex."""
    reflectance: float
    """Specular reflectance at normal incidence (Fresnel's F0)."""
    roughness: float
    """GGX width alpha."""
    subsurface_fwhm_m: float = 0.0
    """Full width at half maximum of the spot that a point of light makes on the surface."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a field lies outside its range.
        """
        check_range("albedo", self.albedo, 0.0, 1.0)
        check_range("reflectance", self.reflectance, 0.0, 1.0)
        check_range("roughness", self.roughness, 0.02, 1.0)
        check_range("subsurface_fwhm_m", self.subsurface_fwhm_m, 0.0, 0.02)


TISSUE = Material(albedo=0.4, reflectance=0.025, roughness=0.2, subsurface_fwhm_m=0.001)
"""Bowel serosa: albedo 0.3 to 0.5, water film (n = 1.37: F0 = 2.4 %), roughness 0.1 to 0.25, subsurface spot about 1 mm."""
TOOL = Material(albedo=0.12, reflectance=0.5, roughness=0.35)
"""Brushed steel."""
STAGE = Material(albedo=0.1, reflectance=0.03, roughness=0.6)
"""Dark anodised plate."""
OTHER = Material(albedo=0.4, reflectance=0.0, roughness=0.6)
"""A matte target without scattering under its surface, such as a printed card."""


@dataclass(frozen=True, kw_only=True)
class StripeOptics:
    """Light source, projection, lens, surfaces and sensor of the stripe camera.

    The chain from the LED to the electrons is radiometric: the intensity that leaves the projector, irradiance by 1/d² and the
    cosine, radiance by the surface's reflectance, irradiance on the sensor by the f-number, electrons by exposure and quantum
    efficiency. The defaults put the bright stripes on a facing tissue plane at 85 mm at about 0.45 of full scale.

    The blur of the mask is a Gaussian in tangent units with the variance

        (source² + pixel²) + (aperture / 4 * (1/z - 1/focus))² + (subsurface / z)²

    where the second part is the defocus of a round aperture. With the defaults the Michelson contrast of a matte facing
    plane is within 0.01 of 0.58 at 70 mm and 0.44 at 100 mm, as measured on the laparoscope that the simulator follows;
    scattering under the surface of tissue takes more of it.
    """

    led_power_w: float = 0.031
    """Optical power through the mask's whole field if it had no stripes."""
    led_exponent: float = 1.0
    """The intensity falls with the cosine of the angle to the projector's axis to this power (1: Lambertian emitter)."""
    source_blur_tan: float = 0.0090
    """Standard deviation of the finite source's and the lenses' blur, tangent units."""
    projector_focus_m: float = 0.050
    """Distance at which the mask is imaged sharply."""
    projector_aperture_m: float = 0.0033
    """Diameter of the projection lens's aperture."""
    stray_fraction: float = 0.05
    """Share of the projected light that arrives without pattern or shadow: scattered in the optics, reflected by the cavity."""
    f_number: float = 4.0
    lens_transmission: float = 0.7
    vignetting_exponent: float = 1.0
    """The lens's transmission falls with the cosine of the angle to the camera's axis to this power."""
    lens_blur_px: float = 0.7
    """Standard deviation of the camera lens's point spread; acts on the stripes."""
    lens_blur_edges: bool = False
    """Whether the point spread acts on the whole image, edges of objects and highlights too, and not only on the stripes."""
    distortion: BrownDistortion = field(default_factory=BrownDistortion)
    """Of the camera's lens, beside the pinhole of its rig."""
    exposure_s: float = 0.015
    wavelength_m: float = 525e-9
    pixel_pitch_m: float = 3.45e-6
    quantum_efficiency: float = 0.62
    full_well_electrons: float = 10500.0
    """Of a Pregius-class sensor; full scale of the output."""
    read_noise_electrons: float = 2.5
    bits: int = 8
    """Of the output: 8, or 12 as the converters of such sensors have."""
    tissue: Material = field(default=TISSUE)
    tool: Material = field(default=TOOL)
    stage: Material = field(default=STAGE)
    other: Material = field(default=OTHER)

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a field lies outside its range.
        """
        for name, low, high in (
            ("led_power_w", 0.0, 10.0),
            ("led_exponent", 0.0, 8.0),
            ("source_blur_tan", 0.0, 0.2),
            ("projector_focus_m", 0.005, 10.0),
            ("projector_aperture_m", 0.0, 0.02),
            ("stray_fraction", 0.0, 0.9),
            ("f_number", 0.7, 64.0),
            ("lens_transmission", 0.01, 1.0),
            ("vignetting_exponent", 0.0, 8.0),
            ("lens_blur_px", 0.0, 10.0),
            ("exposure_s", 1e-6, 1.0),
            ("wavelength_m", 350e-9, 1100e-9),
            ("pixel_pitch_m", 0.5e-6, 50e-6),
            ("quantum_efficiency", 0.01, 1.0),
            ("full_well_electrons", 100.0, 1e6),
            ("read_noise_electrons", 0.0, 1000.0),
        ):
            check_range(name, getattr(self, name), low, high)
        if self.bits not in {8, 12}:
            raise InvalidValueError("bits", self.bits, "8 or 12")

    @cached_property
    def material_table(self) -> NDArray[np.float32]:
        """One row an `ObjectId`: albedo, reflectance, roughness, standard deviation of the subsurface blur in metres."""
        rows = np.zeros((len(ObjectId), 4), dtype=np.float32)
        rows[:, 2] = 1.0
        for object_id, material in (
            (ObjectId.TISSUE, self.tissue),
            (ObjectId.TOOL, self.tool),
            (ObjectId.STAGE, self.stage),
            (ObjectId.OTHER, self.other),
        ):
            sigma = material.subsurface_fwhm_m / math.sqrt(8.0 * math.log(2.0))
            rows[object_id] = material.albedo, material.reflectance, material.roughness, sigma
        return rows

    @property
    def electrons_per_radiance(self) -> float:
        """Photo-electrons a pixel on the optical axis collects, for a radiance of 1 W/(m² sr)."""
        irradiance = math.pi * self.lens_transmission / (4.0 * self.f_number**2)
        photons_per_joule = self.wavelength_m / _PLANCK_TIMES_LIGHT_SPEED_J_M
        return irradiance * self.pixel_pitch_m**2 * self.exposure_s * self.quantum_efficiency * photons_per_joule

    def axial_intensity_w_sr(self, mask: StripeMask) -> float:
        """Radiant intensity along the projector's axis through a clear part of the mask."""
        edges = np.linspace(-mask.half_width_tan, mask.half_width_tan, 201)
        centres = 0.5 * (edges[1:] + edges[:-1])
        square = 1.0 + centres[:, None] ** 2 + centres[None, :] ** 2
        solid_angle_weighted = np.sum(square ** (-1.5 - 0.5 * self.led_exponent)) * (edges[1] - edges[0]) ** 2
        return self.led_power_w / float(solid_angle_weighted)

    def fixed_blur_tan(self, focal_px: float) -> float:
        """Standard deviation of the stripes' blur that does not depend on distance, with a pixel's own width, tangent units.

        The lens's is in it unless it acts on the whole image.
        """
        lens_px = 0.0 if self.lens_blur_edges else self.lens_blur_px
        return math.sqrt(self.source_blur_tan**2 + (lens_px**2 + 1.0 / 12.0) / focal_px**2)
