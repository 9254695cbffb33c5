"""The laparoscope's camera and projector channel, ray cast."""

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import warp as wp
from numpy.typing import NDArray

from laploop.envs.sensors.kernels import shading_kernels, spread_kernels
from laploop.envs.sensors.optics.device_optics import DeviceOptics
from laploop.envs.sensors.optics.lens_distortion import distorted_rays
from laploop.envs.sensors.optics.mask_table import FINE_COLUMNS
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.envs.sensors.ray_camera import RayCamera
from laploop.envs.sensors.soft_shadows import SoftShadows
from laploop.envs.sensors.stripe_capture import StripeCapture
from laploop.envs.sensors.subsurface_spread import SubsurfaceSpread
from laploop.envs.sensors.tracing.scene_geometry import SceneGeometry
from laploop.envs.sensors.tracing.scene_snapshot import SceneSnapshot
from laploop.perception.geometry import Rig
from laploop.perception.reprojection import BrownDistortion


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
        buffers: list[Any] = [wp.zeros(count, dtype=wp.float32, device=self._device) for _ in range(7)]
        self._noise, self._irradiance, self._albedo, self._gloss, self._sharp, self._half_spread, self._electrons = buffers
        self._image: Any = wp.zeros(count, dtype=wp.uint16, device=self._device)
        self._sums: Any = wp.zeros(rig.camera.height, dtype=wp.vec2, device=self._device)
        self._ambient: Any = wp.zeros(1, dtype=wp.float32, device=self._device)
        optics = optics or StripeOptics()
        self._on_device = DeviceOptics(rig, mask_columns, self._device, optics)
        self._shadows = SoftShadows(self._tracer, count, self._device, self._on_device)
        self._subsurface = SubsurfaceSpread(rig.camera, self._tracer, self._device, self._irradiance)
        self._shade = self._record_shade()
        self._light: list[list[Any]] = []
        self._cavity = self._record_cavity()
        self._stages: list[list[list[Any]]] = []
        self._distortion = BrownDistortion()
        self._rays = rig.camera.rays
        self.set_optics(optics)

    @property
    def optics(self) -> StripeOptics:
        """The optical model in use."""
        return self._optics

    def set_optics(self, optics: StripeOptics) -> None:
        """Change the optical model; cheap enough to call before every image.

        Raises:
            InvalidValueError: If the lens distorts so that it shows nothing at some pixel.
        """
        if optics.distortion != self._distortion:
            self._rays = distorted_rays(self.rig.camera, optics.distortion)
            self._tracer.set_rays(self._rays)
            self._traced = None
            self._distortion = optics.distortion
        self._optics = optics
        self._on_device.set(optics, self._rays)
        if self._subsurface.set_table(optics.subsurface_table):
            self._stages = self._record_image()

    def attach_geometry(self, geometry: SceneGeometry) -> None:
        """Look at a scene of triangles from now on."""
        super().attach_geometry(geometry)
        self._light = [*self._shadows.record(self._attached()), self._shade]

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
        trace: list[list[Any]] = []
        if self._traced is not snapshot:
            self._find_surfaces(snapshot)
            trace = self._tracer.trace
        if rng is None:
            self._noise.zero_()
        else:
            self._noise.assign(rng.standard_normal(self._noise.size, dtype=np.float32))
        self._shadows.mark_borders()
        self._runner.run(*trace, *self._light)
        self._traced = snapshot
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

    def _record_shade(self) -> list[Any]:
        """Record the launches that find the projector's light once its shadows are known, whatever the scene."""
        tracer, optics = self._tracer, self._on_device
        depth, normal, tangent, _, object_id, factor = tracer.outputs
        inputs = [tracer.rays, depth, tangent, self._shadows.visible, tracer.projector]
        inputs += [optics.table, optics.stack, optics.projection]
        inputs += [_flat(tracer.rays), _flat(normal), object_id, factor, optics.materials]
        return tracer.record(shading_kernels.shade, inputs, [self._irradiance, self._albedo, self._gloss])

    def _record_cavity(self) -> list[Any]:
        """Record the launches that find the cavity's irradiance: by rows, so that threads do not matter."""
        height, width = self._shape
        inputs = [width, self._irradiance, self._albedo]
        sums = {"kernel": shading_kernels.sum_exitance, "dim": height, "inputs": inputs, "outputs": [self._sums]}
        inputs = [self._on_device.projection, self._sums]
        total = {"kernel": shading_kernels.fill_cavity, "dim": 1, "inputs": inputs, "outputs": [self._ambient]}
        return [wp.launch(**launch, device=self._device, record_cmd=True) for launch in (sums, total)]

    def _record_image(self) -> list[list[list[Any]]]:
        """Record the launches that turn light into an image: stages, each of which needs all of the one before."""
        record = self._tracer.record
        height, width = self._shape
        spread, optics = self._subsurface, self._on_device
        inputs = [spread.result, self._albedo, self._gloss, self._ambient, optics.falloff, optics.sensor]
        expose = record(shading_kernels.expose, inputs, [self._sharp])
        inputs = [self._sharp, optics.lens, optics.lens_count, width]
        along_rows = record(spread_kernels.spread_along_rows, inputs, [self._half_spread])
        inputs = [self._half_spread, optics.lens, optics.lens_count, width, height]
        along_columns = record(spread_kernels.spread_along_columns, inputs, [self._electrons])
        digitise = record(shading_kernels.digitise, [self._electrons, optics.sensor, self._noise], [self._image])
        return [*spread.stages[:-1], [*spread.stages[-1], expose], [along_rows], [along_columns, digitise]]


def _flat(vectors: Any) -> Any:
    """Return a device array of vectors as one of numbers, which shares their memory."""
    return vectors.view(wp.float32).flatten()
