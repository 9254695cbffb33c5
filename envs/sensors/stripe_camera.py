"""The laparoscope's camera and projector channel, ray cast."""

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy.special import ive

from laploop.envs.sensors.kernels import shading_kernels
from laploop.envs.sensors.optics.lens_distortion import distorted_rays
from laploop.envs.sensors.optics.mask_stack import MaskStack
from laploop.envs.sensors.optics.mask_table import FINE_COLUMNS, MaskTable
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.envs.sensors.ray_camera import RayCamera
from laploop.envs.sensors.stripe_capture import StripeCapture
from laploop.envs.sensors.tracing.scene_snapshot import SceneSnapshot
from laploop.perception.geometry import Rig
from laploop.perception.reprojection import BrownDistortion

_NARROWEST_SPREAD_PX = 0.01
_LEAST_WEIGHT = 1e-7


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
        self._noise: Any = wp.zeros(count, dtype=wp.float32, device=self._device)
        self._electrons: Any = wp.zeros(count, dtype=wp.float32, device=self._device)
        self._half_spread: Any = wp.zeros(count, dtype=wp.float32, device=self._device)
        self._spread: Any = wp.zeros(count, dtype=wp.float32, device=self._device)
        self._image: Any = wp.zeros(count, dtype=wp.uint16, device=self._device)
        self._table: Any = wp.zeros((0, 0), dtype=wp.float32, device=self._device)
        self._stack: Any = wp.zeros((0, 0, 0), dtype=wp.float32, device=self._device)
        if rig.mask.varies_along_y:
            self._mask: MaskTable | MaskStack = MaskStack.from_mask(rig.mask)
            self._stack = wp.array(self._mask.transmission, dtype=wp.float32, device=self._device)
        else:
            self._mask = MaskTable.from_mask(rig.mask, mask_columns)
            self._table = wp.array(self._mask.transmission, dtype=wp.float32, device=self._device)
        self._distortion = BrownDistortion()
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
        if optics.distortion != self._distortion:
            self._tracer.set_rays(distorted_rays(self.rig.camera, optics.distortion))
            self._distortion = optics.distortion
        self._optics = optics
        tracer, sensor = self._tracer, self._sensor()
        materials: Any = wp.array(optics.material_table, dtype=wp.vec4, device=self._device)
        inputs = [tracer.rays, *tracer.outputs, tracer.projector, materials, self._table, self._stack, self._projection()]
        inputs += [sensor, self._noise]
        self._shade = tracer.record(shading_kernels.shade, inputs, [self._electrons, self._image])
        self._spreading: list[list[Any]] = []
        self._seen = self._electrons
        if optics.lens_blur_edges and optics.lens_blur_px >= _NARROWEST_SPREAD_PX:
            self._seen = self._spread
            self._spreading = self._record_spreading(optics.lens_blur_px)
            inputs = [self._spread, sensor, self._noise]
            self._spreading.append(tracer.record(shading_kernels.digitise, inputs, [self._image]))

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
        self._runner.run(*self._tracer.trace, self._shade)
        for stage in self._spreading:
            # Each needs the whole result of the one before.
            self._runner.run(stage)
        view = self._tracer.read()
        image = self._image.numpy().reshape(self._shape).astype(np.uint8 if self._optics.bits == 8 else np.uint16)
        electrons = self._seen.numpy().reshape(self._shape).copy()
        exposure_s = self._optics.exposure_control.next_exposure_s(self._optics.exposure_s, image, self._optics.bits)
        if exposure_s != self._optics.exposure_s:
            self.set_optics(replace(self._optics, exposure_s=exposure_s))
        return StripeCapture(**vars(view), image=image, electrons=electrons)

    def _record_spreading(self, sigma_px: float) -> list[list[Any]]:
        """Record the lens's point spread on the electrons, along x and then along y.

        The filter is the discrete Gaussian exp(-s²) I_k(s²) of Lindeberg (1990): it has the Gaussian's variance at any width,
        and its weights add up to one.
        """
        weights = ive(np.arange(int(4.0 + 8.0 * sigma_px)), sigma_px**2)
        weights = weights[weights > _LEAST_WEIGHT]
        weights /= weights[0] + 2.0 * weights[1:].sum()
        half: Any = wp.array(weights, dtype=wp.float32, device=self._device)
        height, width = self._shape
        return [
            self._tracer.record(shading_kernels.spread, [source, half, width, height, across, 1 - across], [target])
            for source, across, target in ((self._electrons, 1, self._half_spread), (self._half_spread, 0, self._spread))
        ]

    def _projection(self) -> Any:
        """Pack the numbers of the projector's light for the kernels."""
        optics, mask, table = self._optics, self.rig.mask, self._mask
        projection = shading_kernels.Projection()
        projection.intensity_w_sr = optics.axial_intensity_w_sr(mask)
        projection.led_exponent = optics.led_exponent
        projection.stray_fraction = optics.stray_fraction
        projection.fixed_variance = optics.fixed_blur_tan(self.rig.camera.fx) ** 2
        projection.defocus_slope = optics.projector_aperture_m / 4.0
        projection.inverse_focus = 1.0 / optics.projector_focus_m
        projection.table_start = table.start
        projection.columns_per_tan = 1.0 / table.step
        projection.levels_per_tan = 1.0 / table.sigma_step
        return projection

    def _sensor(self) -> Any:
        """Pack the lens's and the sensor's numbers for the kernels."""
        optics = self._optics
        sensor = shading_kernels.Sensor()
        sensor.electrons_per_radiance = optics.electrons_per_radiance
        sensor.vignetting_exponent = optics.vignetting_exponent
        sensor.levels = float(2**optics.bits - 1)
        sensor.levels_per_electron = sensor.levels / optics.full_well_electrons
        sensor.read_variance = optics.read_noise_electrons**2
        return sensor
