"""The laparoscope's camera and projector channel, ray cast."""

import math
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy.special import ive

from laploop.envs.sensors.kernels import shading_kernels, spread_kernels
from laploop.envs.sensors.optics.lens_distortion import distorted_rays
from laploop.envs.sensors.optics.mask_stack import MaskStack
from laploop.envs.sensors.optics.mask_table import FINE_COLUMNS, MaskTable
from laploop.envs.sensors.optics.projection_blur import ProjectionBlur
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.envs.sensors.ray_camera import RayCamera
from laploop.envs.sensors.soft_shadows import SoftShadows
from laploop.envs.sensors.stripe_capture import StripeCapture
from laploop.envs.sensors.subsurface_spread import SubsurfaceSpread
from laploop.envs.sensors.tracing.scene_geometry import SceneGeometry
from laploop.envs.sensors.tracing.scene_snapshot import SceneSnapshot
from laploop.perception.geometry import Rig
from laploop.perception.reprojection import BrownDistortion

_NARROWEST_SPREAD_PX = 0.01
_NARROWEST_DISK_TAN = 1e-6
_LEAST_WEIGHT = 1e-5


class StripeCamera(RayCamera):
    """Renders what the camera channel sees of a scene that the projector channel lights through its mask.

    One ray a pixel, through its centre, finds the surface; a ray from there to the projector's centre finds shadows; a
    radiometric model (`StripeOptics`) makes electrons and grey values.
    """

    def __init__(
        self,
        rig: Rig,
        optics: StripeOptics | None = None,
        device: str = "cpu",
        threads: int | None = None,
        *,
        mask_columns: int = FINE_COLUMNS,
    ) -> None:
        """Allocate the buffers and compile the kernels; `attach` a scene before the first image.

        Args:
            rig: Geometry of camera, projector and mask.
            optics: The optical model; by default the nominal one.
            device: See `RayCamera`.
            threads: See `RayCamera`.
            mask_columns: Columns of the mask's table, see `MaskTable.from_mask`; fewer make a camera with a new mask sooner.

        Raises:
            InvalidValueError: If the number of columns is not from 257 to 16385, or the lens shows nothing at some pixel;
                further errors as for `RayCamera`.
        """
        super().__init__(rig, device, threads)
        self._shape = (rig.camera.height, rig.camera.width)
        count = rig.camera.height * rig.camera.width
        self._noise, self._irradiance, self._albedo, self._gloss, self._sharp, self._half_spread, self._electrons = (
            wp.zeros(count, dtype=wp.float32, device=self._device) for _ in range(7)
        )
        self._sums: Any = wp.zeros(rig.camera.height, dtype=wp.vec2, device=self._device)
        self._ambient: Any = wp.zeros(1, dtype=wp.float32, device=self._device)
        self._falloff: Any = wp.zeros(count, dtype=wp.float32, device=self._device)
        self._image: Any = wp.zeros(count, dtype=wp.uint16, device=self._device)
        self._shadows = SoftShadows(self._tracer, count, self._device)
        self._subsurface = SubsurfaceSpread(rig.camera, self._tracer, self._device)
        self._mask: MaskTable | MaskStack
        if rig.mask.varies_along_y:
            self._mask = MaskStack.from_mask(rig.mask)
        else:
            self._mask = MaskTable.from_mask(rig.mask, mask_columns)
        self._table: Any = wp.zeros((0, 0), dtype=wp.float32, device=self._device)
        self._stack: Any = wp.zeros((0, 0, 0), dtype=wp.float32, device=self._device)
        self._blur: ProjectionBlur | None = None
        self._seen_rays = (BrownDistortion(), math.nan)
        self.set_optics(optics or StripeOptics())

    @property
    def optics(self) -> StripeOptics:
        """The optical model in use."""
        return self._optics

    def set_optics(self, optics: StripeOptics) -> None:
        """Change the optical model; cheap enough to call before every image.

        Raises:
            InvalidValueError: If the lens distorts so that it shows nothing at some pixel.
        """
        self._see_through(optics)
        self._project_through(optics)
        self._optics = optics
        self._light = self._record_light()
        self._cavity = self._record_cavity(optics.cavity_fraction)
        record = self._tracer.record
        stages = self._subsurface.record(self._irradiance, optics.subsurface_table)
        inputs = [self._subsurface.result, self._albedo, self._gloss, self._ambient, self._falloff]
        inputs.append(optics.electrons_per_radiance)
        blurred = optics.lens_blur_px >= _NARROWEST_SPREAD_PX
        sharp = self._sharp if blurred else self._electrons
        expose = record(shading_kernels.expose, inputs, [sharp])
        stages = [*stages[:-1], [*stages[-1], expose]] if stages else [[expose]]
        if blurred:
            stages += self._record_lens(optics.lens_blur_px)
        inputs = [self._electrons, _sensor(optics), self._noise]
        stages[-1].append(record(shading_kernels.digitise, inputs, [self._image]))
        self._stages = stages

    def attach_geometry(self, geometry: SceneGeometry) -> None:
        """Look at a scene of triangles from now on."""
        super().attach_geometry(geometry)
        self._light = self._record_light()

    def capture(
        self, data: mujoco.MjData | None, world_from_camera: NDArray[np.float64], rng: np.random.Generator | None
    ) -> StripeCapture:
        """Take an image of the scene as it is now.

        Args:
            data: See `exact`.
            world_from_camera: See `exact`.
            rng: Source of the shot and read noise; None takes the expected image.

        Raises:
            InvalidValueError: If no scene is attached or the pose is not a rigid transform.
        """
        return self.render(self.snapshot(data, world_from_camera), rng)

    def render(self, snapshot: SceneSnapshot, rng: np.random.Generator | None) -> StripeCapture:
        """Take an image of the attached scene as it was at a moment; `rng` as for `capture`."""
        self._find_surfaces(snapshot)
        if rng is None:
            self._noise.zero_()
        else:
            self._noise.assign(rng.standard_normal(self._noise.size, dtype=np.float32))
        self._shadows.mark_borders()
        self._runner.run(*self._tracer.trace, *self._light)
        for launch in self._cavity:
            launch.launch()
        for stage in self._stages:
            # Each needs the whole result of the one before.
            self._runner.run(*stage)
        view = self._tracer.read()
        image = self._image.numpy().reshape(self._shape).astype(np.uint8 if self._optics.bits == 8 else np.uint16)
        electrons = self._electrons.numpy().reshape(self._shape).copy()
        exposure_s = self._optics.exposure_control.next_exposure_s(
            self._optics.exposure_s, image, self._optics.bits, self._optics.response.gamma
        )
        if exposure_s != self._optics.exposure_s:
            self.set_optics(replace(self._optics, exposure_s=exposure_s))
        return StripeCapture(**vars(view), image=image, electrons=electrons)

    def _see_through(self, optics: StripeOptics) -> None:
        """Take the rays of a lens, and its natural fall-off."""
        seen = (optics.distortion, optics.vignetting_exponent)
        if seen == self._seen_rays:
            return
        rays = self.rig.camera.rays
        if optics.distortion != self._seen_rays[0]:
            rays = distorted_rays(self.rig.camera, optics.distortion)
            self._tracer.set_rays(rays)
        self._falloff.assign(np.linalg.norm(rays, axis=-1).ravel() ** -optics.vignetting_exponent)
        self._seen_rays = seen

    def _project_through(self, optics: StripeOptics) -> None:
        """Blur the mask as source and aperture do."""
        blur = optics.projection_blur(self.rig.camera.fx)
        if blur == self._blur:
            return
        transmission = self._mask.blurred(blur)
        array: Any = wp.array(transmission, dtype=wp.float32, device=self._device)
        if transmission.ndim == 2:
            self._table = array
        else:
            self._stack = array
        self._levels_per_tan = (len(transmission) - 1) / max(blur.largest_radius_tan, _NARROWEST_DISK_TAN)
        self._blur = blur

    def _record_light(self) -> list[list[Any]]:
        """Record the launches that find shadows and the projector's light, for the scene and the optics in use."""
        optics, tracer = self._optics, self._tracer
        projection = self._projection(optics)
        stages = self._shadows.record(0.5 * optics.projector_aperture_m, self._table, self._stack, projection)
        materials: Any = wp.array(optics.material_table, dtype=wp.vec3, device=self._device)
        depth, normal, tangent, _, object_id, factor = tracer.outputs
        inputs = [tracer.rays, depth, normal, tangent, object_id, factor, self._shadows.visible, tracer.projector, materials]
        inputs += [self._table, self._stack, projection]
        return [*stages, tracer.record(shading_kernels.shade, inputs, [self._irradiance, self._albedo, self._gloss])]

    def _record_cavity(self, fraction: float) -> list[Any]:
        """Record the launches that find the cavity's irradiance: by rows, so that threads do not matter."""
        height, width = self._shape
        inputs = [width, self._irradiance, self._albedo]
        sums = {"kernel": shading_kernels.sum_exitance, "dim": height, "inputs": inputs, "outputs": [self._sums]}
        total = {"kernel": shading_kernels.fill_cavity, "dim": 1, "inputs": [fraction, self._sums], "outputs": [self._ambient]}
        return [wp.launch(**launch, device=self._device, record_cmd=True) for launch in (sums, total)]

    def _record_lens(self, sigma_px: float) -> list[list[list[Any]]]:
        """Record the lens's point spread on the electrons, along x and then along y.

        The filter is the discrete Gaussian exp(-s²) I_k(s²) of Lindeberg (1990): it has the Gaussian's variance at any width,
        and its weights add up to one.
        """
        weights = ive(np.arange(int(4.0 + 8.0 * sigma_px)), sigma_px**2)
        weights = weights[weights > _LEAST_WEIGHT]
        weights /= weights[0] + 2.0 * weights[1:].sum()
        half: Any = wp.array(weights, dtype=wp.float32, device=self._device)
        height, width = self._shape
        record = self._tracer.record
        return [
            [record(spread_kernels.spread_along_rows, [self._sharp, half, width], [self._half_spread])],
            [record(spread_kernels.spread_along_columns, [self._half_spread, half, width, height], [self._electrons])],
        ]

    def _projection(self, optics: StripeOptics) -> Any:
        """Pack the numbers of the projector's light for the kernels."""
        mask, table = self.rig.mask, self._mask
        projection = shading_kernels.Projection()
        projection.intensity_w_sr = optics.axial_intensity_w_sr(mask)
        projection.led_exponent = optics.led_exponent
        projection.patterned = 1.0 - optics.glare_fraction
        projection.glare = optics.glare_fraction * table.mean
        projection.variance = optics.projection_blur(self.rig.camera.fx).sigma_tan ** 2
        projection.radius = 0.5 * optics.projector_aperture_m
        projection.inverse_focus = 1.0 / optics.projector_focus_m
        projection.table_start = table.start
        projection.columns_per_tan = 1.0 / table.step
        projection.levels_per_tan = self._levels_per_tan
        return projection


def _sensor(optics: StripeOptics) -> Any:
    """Pack the sensor's numbers for the kernels."""
    sensor = shading_kernels.Sensor()
    sensor.levels = float(2**optics.bits - 1)
    sensor.levels_per_electron = optics.response.gain * sensor.levels / optics.full_well_electrons
    sensor.read_variance = optics.read_noise_electrons**2
    sensor.inverse_gamma = 1.0 / optics.response.gamma
    return sensor
