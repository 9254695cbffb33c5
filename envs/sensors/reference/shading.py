"""Light that surfaces under its projector return to the reference camera."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from laploop.arrays import Float32
from laploop.envs.sensors.reference.optics import ReferenceOptics

_LEAST_COSINE = np.float32(1e-3)


@dataclass(frozen=True, kw_only=True, eq=False)
class ReferenceLight:
    """Radiance of n points, relative to a facing matte surface of the reference albedo in full light."""

    matte: Float32
    """(n,), scattered light, which carries the pattern; zero where the projector does not reach."""
    gloss: Float32
    """(n,), specular reflection."""
    ambient: Float32
    """(n,), ambient light."""
    view_cosine: Float32
    """(n,), cosine of the angle between normal and line of sight."""
    tint: Float32
    """(n, 3), red, green and blue of the scattered light."""

    @property
    def total(self) -> Float32:
        """(n,), all light."""
        return self.matte + self.gloss + self.ambient

    def colour(self, saturation_ratio: float) -> Float32:
        """Return linear red, green and blue, (n, 3), 1 where the sensor saturates."""
        return ((self.matte + self.ambient)[:, None] * self.tint + self.gloss[:, None]) * np.float32(1.0 / saturation_ratio)


def light_of(
    points: Float32,
    normals: Float32,
    lit: NDArray[np.bool_],
    object_id: NDArray[np.uint8],
    albedo_factor: Float32,
    optics: ReferenceOptics,
) -> ReferenceLight:
    """Return the light of points (n, 3), in metres in the camera's frame, with unit normals towards the camera.

    Lambert's law and, for gloss, GGX (Walter et al. 2007, with Smith's masking). The light's decrease with distance is left
    out: the camera's exposure compensates for it.
    """
    albedo, reflectance, roughness = (optics.material_table[:, column][object_id] for column in range(3))
    relative_albedo = albedo * albedo_factor * np.float32(1.0 / optics.reference_albedo)
    projector_from_camera = optics.rig.projector_from_camera
    projector = (-projector_from_camera[:3, :3].T @ projector_from_camera[:3, 3]).astype(np.float32)
    to_light = _unit(projector - points)
    to_view = _unit(-points)
    half = _unit(to_light + to_view)
    n_l, n_v, n_h = _dot(normals, to_light), _dot(normals, to_view), _dot(normals, half)
    direct = np.where(lit, np.maximum(n_l, 0.0), 0.0).astype(np.float32)
    a2 = roughness * roughness
    q = n_h * n_h * (a2 - 1.0) + 1.0
    n_l, n_v = np.maximum(n_l, _LEAST_COSINE), np.maximum(n_v, _LEAST_COSINE)
    # Radiances here are multiplied by pi over the reference albedo; this cancels the pi of the distribution.
    visibility = 0.5 / (n_l * np.sqrt(a2 + (1.0 - a2) * n_v * n_v) + n_v * np.sqrt(a2 + (1.0 - a2) * n_l * n_l))
    fresnel = reflectance + (1.0 - reflectance) * (1.0 - _dot(to_view, half)) ** 5
    gloss = a2 / (q * q) * visibility * fresnel * direct * np.float32(1.0 / optics.reference_albedo)
    return ReferenceLight(
        matte=relative_albedo * direct,
        gloss=gloss.astype(np.float32),
        ambient=relative_albedo * np.float32(optics.ambient_fraction),
        view_cosine=n_v,
        tint=optics.material_table[:, 3:][object_id],
    )


def srgb(linear: Float32) -> Float32:
    """Encode linear light from 0 to 1 by the sRGB curve (IEC 61966-2-1)."""
    light = np.clip(linear, 0.0, 1.0)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** np.float32(1.0 / 2.4) - 0.055).astype(np.float32)


def _dot(a: Float32, b: Float32) -> Float32:
    return np.asarray(np.einsum("ij,ij->i", a, b))


def _unit(vectors: Float32) -> Float32:
    return np.asarray(vectors / np.sqrt(_dot(vectors, vectors))[:, None])
