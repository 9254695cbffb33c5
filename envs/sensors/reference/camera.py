"""The reference camera of the optical bench: a structured-light depth camera that views the phantom from the side."""

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from laploop.arrays import Array, Float32
from laploop.envs.sensors.ray_camera import RayCamera
from laploop.envs.sensors.reference.noise import ReferenceNoise
from laploop.envs.sensors.reference.optics import ReferenceOptics
from laploop.envs.sensors.reference.shading import ReferenceLight, light_of, srgb
from laploop.envs.sensors.stripe_capture import ExactView
from laploop.errors import InvalidValueError


@dataclass(frozen=True, kw_only=True, eq=False)
class ReferenceCapture:
    """A point cloud in image order, with the names and units of the camera's own software.

    All floating-point arrays are NaN at the same pixels: where there is no point.
    """

    xyz: Float32
    """(height, width, 3), millimetres, in the frame of the camera: x right, y down, z forward."""
    z: Float32
    """(height, width), millimetres; the same as `xyz[..., 2]`."""
    rgba: NDArray[np.uint8]
    """(height, width, 4), the colour picture under the projector's white light, sRGB; its alpha is 255 everywhere."""
    normals: Float32
    """(height, width, 3), unit vectors towards the camera."""
    snr: Float32
    """(height, width), signal-to-noise ratio."""

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(height, width), where there is a point."""
        return np.isfinite(self.z)


class ReferenceCamera(RayCamera):
    """A Zivid 2+ M60: measures a point for each pixel that both its camera and its projector see.

    Errors and gaps follow `ReferenceOptics`. In what `exact` returns, `lit` is True inside the square around the projector's
    field, which is a little higher than the field itself.
    """

    def __init__(self, optics: ReferenceOptics | None = None, device: str = "cpu", threads: int | None = None) -> None:
        """Allocate the buffers and compile the kernels; `attach` a scene before the first capture.

        Args:
            optics: Geometry and errors; by default the nominal ones, at 2x2 sampling.
            device: See `RayCamera`.
            threads: See `RayCamera`.
        """
        self.optics = optics or ReferenceOptics()
        super().__init__(self.optics.rig, device, threads)
        self.noise = ReferenceNoise(self.optics)
        self._rays: Float32 = self.intrinsics.rays.reshape(-1, 3).astype(np.float32)

    def capture(
        self, data: mujoco.MjData | None, world_from_camera: Array, rng: np.random.Generator | None
    ) -> ReferenceCapture:
        """Measure the scene as it is now.

        Args:
            data: See `exact`.
            world_from_camera: See `exact`.
            rng: Source of the noise of points, normals and picture; None leaves it out, but not the camera's scale and bend.

        Raises:
            InvalidValueError: If no scene is attached or the pose is not a rigid transform.
        """
        view = self.exact(data, world_from_camera)
        optics = self.optics
        hit = np.flatnonzero(view.object_id)
        z_m = view.depth_mm.ravel()[hit] * np.float32(1e-3)
        lit = self._in_field(view).ravel()[hit]
        normals = view.normals.reshape(-1, 3)[hit]
        factor: Float32 = self._tracer.outputs[-1].numpy()[hit]
        light = light_of(self._rays[hit] * z_m[:, None], normals, lit, view.object_id.ravel()[hit], factor, optics)
        relative_snr = np.sqrt(light.matte)
        found = (z_m >= optics.near_m) & (z_m <= optics.far_m)
        if optics.needs_projector:
            found &= lit & (relative_snr >= optics.snr_min / optics.snr_reference)
        if optics.saturated_is_missing:
            found &= light.total < optics.saturation_ratio
        kept = hit[found]
        z, unit_normals = self._measure(
            kept, view.depth_mm.ravel()[kept], normals[found], relative_snr[found], light.view_cosine[found], rng
        )
        shape = view.depth_mm.shape
        return ReferenceCapture(
            xyz=_scatter(self._rays[kept] * z[:, None], kept, (*shape, 3)),
            z=_scatter(z, kept, shape),
            rgba=self._picture(light, hit, rng),
            normals=_scatter(unit_normals, kept, (*shape, 3)),
            snr=_scatter(relative_snr[found] * np.float32(optics.snr_reference), kept, shape),
        )

    def _in_field(self, view: ExactView) -> NDArray[np.bool_]:
        """Return where the projector's light arrives, (height, width)."""
        optics = self.optics
        inside = np.abs(view.projector_x) <= optics.projector_half_width_tan
        inside &= np.abs(view.projector_y) <= optics.projector_half_height_tan
        return inside & view.lit

    def _measure(
        self,
        pixels: NDArray[np.intp],
        z_mm: Float32,
        normals: Float32,
        relative_snr: Float32,
        cosine: Float32,
        rng: np.random.Generator | None,
    ) -> tuple[Float32, Float32]:
        """Add the camera's errors to the depth (n,) and the normals (n, 3) of some pixels."""
        noise = self.noise
        z = z_mm * np.float32(1.0 + noise.scale) + noise.bend_mm.ravel()[pixels]
        if rng is None or self.optics.point_noise_mm == 0.0:
            return z, normals
        sigma = noise.sigma_mm(z_mm, relative_snr, cosine)
        z += sigma * rng.standard_normal(len(pixels), dtype=np.float32)
        # A step along the normal only changes its length, so that three numbers are as good as two across it.
        step = noise.normal_sigma_rad(z_mm, sigma)[:, None] * rng.standard_normal((len(pixels), 3), dtype=np.float32)
        turned = normals + step
        return z, turned / np.linalg.norm(turned, axis=1, keepdims=True)

    def _picture(self, light: ReferenceLight, hit: NDArray[np.intp], rng: np.random.Generator | None) -> NDArray[np.uint8]:
        """Make the colour picture, (height, width, 4)."""
        optics, camera = self.optics, self.intrinsics
        linear = np.zeros((camera.height, camera.width, 3), dtype=np.float32)
        linear.reshape(-1, 3)[hit] = np.minimum(light.colour(optics.saturation_ratio), 1.0)
        blur = optics.lens_blur_px / optics.step
        if blur > 0.0:
            linear = ndimage.gaussian_filter(linear, sigma=(blur, blur, 0.0), mode="nearest", truncate=3.0)
        encoded = srgb(linear)
        if rng is not None and optics.colour_noise > 0.0:
            encoded += np.float32(optics.colour_noise) * rng.standard_normal(encoded.shape, dtype=np.float32)
        rgba = np.full((camera.height, camera.width, 4), 255, dtype=np.uint8)
        rgba[..., :3] = np.clip(encoded * np.float32(255.0) + np.float32(0.5), 0.0, 255.0).astype(np.uint8)
        return rgba


def lateral_mount(
    target_in_world: ArrayLike,
    *,
    distance_m: float = 0.6,
    azimuth_rad: float = -0.5 * math.pi,
    elevation_rad: float = math.radians(55.0),
) -> Array:
    """Return the pose `world_from_camera`, 4x4, of a camera beside the phantom that views it, its x axis level.

    By default the camera is on the world's -y side, between the two arms, and low enough to look past the scope: a shaft
    vertically above the target that ends 90 mm from it hides only what lies more than 55 mm behind the target.

    Args:
        target_in_world: The point (3,) in the image's centre: the middle of the phantom's surface.
        distance_m: From the camera to the target.
        azimuth_rad: Direction of the camera as seen from the target, from the world's x towards its y.
        elevation_rad: Elevation of the camera as seen from the target, above the horizontal.

    Raises:
        InvalidValueError: If the target is not a point, or a number lies outside its range.
    """
    target = np.asarray(target_in_world, dtype=np.float64)
    if target.shape != (3,) or not np.isfinite(target).all():
        raise InvalidValueError("target_in_world", target_in_world, "three finite coordinates")
    if not 0.05 <= distance_m <= 5.0:
        raise InvalidValueError("distance_m", distance_m, "0.05 to 5")
    if not 0.0 <= elevation_rad <= math.radians(85.0):
        raise InvalidValueError("elevation_rad", elevation_rad, "0 to 1.48 (85 degrees)")
    level = np.array([math.cos(azimuth_rad), math.sin(azimuth_rad), 0.0])
    outwards = math.cos(elevation_rad) * level + np.array([0.0, 0.0, math.sin(elevation_rad)])
    right = np.cross([0.0, 0.0, 1.0], level)
    world_from_camera = np.eye(4)
    world_from_camera[:3, :3] = np.column_stack([right, np.cross(-outwards, right), -outwards])
    world_from_camera[:3, 3] = target + distance_m * outwards
    return world_from_camera


def _scatter(values: Float32, pixels: NDArray[np.intp], shape: tuple[int, ...]) -> Float32:
    """Put values (n, ...) at their pixels of an image of NaN."""
    image = np.full(shape, np.nan, dtype=np.float32)
    image.reshape(-1, *values.shape[1:])[pixels] = values
    return image
