"""The spread of light under a surface for the path tracer: a sum over all neighbours by the profile itself.

The stripe camera filters with Gaussians along rows and columns, to which a dipole is fitted. Nothing of that is used here.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from laploop.arrays import Array
from laploop.envs.sensors.optics.subsurface import Subsurface
from laploop.perception.geometry import Rig

_GAUSSIAN_REACH = 1.7
"""Four standard deviations in full widths at half maximum."""
_DIPOLE_REACH = 7.0
"""Decay lengths, beyond which less than a thousandth of a dipole's light comes out."""
_MOST_OBLIQUE = 0.05
"""Least cosine between ray and normal; a pixel that shows a surface from the side does not stand for all that it hides."""


@dataclass(frozen=True, kw_only=True)
class SpotProfile:
    """How much light comes out at a distance from where it went in, up to a factor."""

    at: Callable[[Array], Array]
    """Called with squared distances, m²."""
    reach_m: float
    """Distance up to which it counts."""

    @classmethod
    def of(cls, subsurface: Subsurface) -> "SpotProfile":
        """Return the profile of a material whose light spreads."""
        if subsurface.profile == "gaussian":
            rate = 4.0 * math.log(2.0) / subsurface.fwhm_m**2
            return cls(at=lambda square: np.exp(-rate * square), reach_m=_GAUSSIAN_REACH * subsurface.fwhm_m)
        scattering, absorption = subsurface.reduced_scattering_per_m, subsurface.absorption_per_m
        decay = math.sqrt(3.0 * absorption * (scattering + absorption))
        index = subsurface.refractive_index
        return cls(at=lambda square: dipole(square, scattering, absorption, index), reach_m=_DIPOLE_REACH / decay)


def dipole(square: Array, scattering: float, absorption: float, index: float) -> Array:
    """Return the diffuse reflectance of Jensen et al. (2001), section 2.1, per m² at an albedo of 1.

    With the sources' distances d_r and d_v from where the light comes out, and their depths z_r and z_v,

        R = sum over both of z (1 + k d) exp(-k d) / (4 pi d³)

    Args:
        square: Squared distances on the surface, m², of any shape.
        scattering: mu_s' per metre.
        absorption: mu_a per metre.
        index: Refractive index of the medium against air.
    """
    extinction = scattering + absorption
    fresnel = -1.440 / index**2 + 0.710 / index + 0.668 + 0.0636 * index
    depth = 1.0 / extinction
    height = depth * (1.0 + 4.0 / 3.0 * (1.0 + fresnel) / (1.0 - fresnel))
    decay = math.sqrt(3.0 * absorption * extinction)
    total = np.zeros_like(square)
    for z in (depth, height):
        d = np.sqrt(square + z**2)
        total += z * (1.0 + decay * d) * np.exp(-decay * d) / (4.0 * math.pi * d**3)
    return total


def spread(
    irradiance: Array,
    scatters: NDArray[np.bool_],
    position: Array,
    normals: Array,
    rays: Array,
    subsurface: Subsurface,
    rig: Rig,
) -> Array:
    """Return the irradiance (rows, width) after it spread, where `scatters`, by the distance in space.

    Every neighbour counts by the profile and by the area that its pixel shows; the weights add up to 1.

    Args:
        irradiance: Before the spread.
        scatters: Where light spreads.
        position: (rows, width, 3), metres, in the camera's frame.
        normals: (rows, width, 3), unit.
        rays: (rows, width, 3), with z = 1.
        subsurface: With a profile other than none.
        rig: Its camera gives the size of the pixels.
    """
    profile = SpotProfile.of(subsurface)
    height, width = scatters.shape
    cosine = np.abs(np.sum(normals * rays, axis=-1))
    area = np.where(scatters, position[..., 2] ** 2 / (rig.camera.fx * rig.camera.fy) / np.maximum(cosine, _MOST_OBLIQUE), 0.0)
    reach = math.ceil(profile.reach_m * rig.camera.fx / float(np.nanmin(position[..., 2])))
    across_reach, down_reach = min(reach, width - 1), min(reach, height - 1)
    total, weights = np.zeros_like(irradiance), np.zeros_like(irradiance)
    for down in range(-down_reach, down_reach + 1):
        for across in range(-across_reach, across_reach + 1):
            here = np.s_[max(-down, 0) : height - max(down, 0), max(-across, 0) : width - max(across, 0)]
            there = np.s_[max(down, 0) : height - max(-down, 0), max(across, 0) : width - max(-across, 0)]
            square = np.sum((position[there] - position[here]) ** 2, axis=-1)
            weight = np.nan_to_num(area[there] * profile.at(square))
            total[here] += weight * irradiance[there]
            weights[here] += weight
    return np.where(scatters, total / np.maximum(weights, 1e-30), irradiance)
