"""The laparoscope's camera and projector channel, ray cast."""

from collections.abc import Collection
from typing import Any

import mujoco
import numpy as np
import warp as wp
from numpy.typing import NDArray

from laploop.envs.sensors import kernels
from laploop.envs.sensors.mask_table import MaskTable
from laploop.envs.sensors.ray_scene import RayScene, open_device
from laploop.envs.sensors.scene_geometry import SceneGeometry
from laploop.envs.sensors.strip_runner import StripRunner
from laploop.envs.sensors.stripe_capture import ExactView, StripeCapture
from laploop.envs.sensors.stripe_optics import StripeOptics
from laploop.envs.sensors.view_tracer import ViewTracer
from laploop.errors import InvalidValueError
from laploop.perception.geometry import Rig


class StripeCamera:
    """Renders what the camera channel sees of a scene that the projector channel lights through its mask.

    One ray a pixel, through its centre, finds the surface; its way back to the projector's centre tells whether light gets
    there; a radiometric model (`StripeOptics`) makes electrons and grey values of it. Buffers are allocated once; what is
    returned is the caller's own.
    """

    def __init__(self, rig: Rig, optics: StripeOptics | None = None, device: str = "cpu", threads: int | None = None) -> None:
        """Prepare the buffers and compile the kernels; `attach` a scene before the first image.

        Args:
            rig: Geometry of camera, projector and mask.
            optics: The optical model; the nominal one by default.
            device: A Warp device: "cpu", "cuda", "cuda:0", ...
            threads: How many threads share an image on the CPU; by default two where there are two cores.

        Raises:
            InvalidValueError: If the device or the number of threads is impossible.
        """
        self.rig = rig
        self._device = open_device(device)
        self._runner = StripRunner(self._device, threads)
        self._tracer = ViewTracer(rig, self._device, self._runner)
        self._scene: RayScene | None = None
        self._shape = (rig.camera.height, rig.camera.width)
        count = rig.camera.height * rig.camera.width
        self._noise: Any = wp.zeros(count, dtype=wp.float32, device=self._device)
        self._electrons: Any = wp.zeros(count, dtype=wp.float32, device=self._device)
        self._image: Any = wp.zeros(count, dtype=wp.uint8, device=self._device)
        self._mask_table = MaskTable.from_mask(rig.mask)
        self._transmission: Any = wp.array(self._mask_table.transmission, dtype=wp.float32, device=self._device)
        self.set_optics(optics or StripeOptics())

    @property
    def optics(self) -> StripeOptics:
        """The optical model in use."""
        return self._optics

    def set_optics(self, optics: StripeOptics) -> None:
        """Change the optical model; cheap enough to do before every image."""
        self._optics = optics
        materials: Any = wp.array(optics.material_table, dtype=wp.vec4, device=self._device)
        tracer = self._tracer
        inputs = [tracer.rays, tracer.depth, tracer.normals, tracer.projector, tracer.flags, tracer.object_id]
        inputs += [tracer.albedo_factor, materials, self._transmission, self._projection(), self._sensor(), self._noise]
        self._shade = tracer.record(kernels.shade, inputs, [self._electrons, self._image])

    def attach(
        self, model: mujoco.MjModel, *, groups: Collection[int] = (1,), rng: np.random.Generator | None = None
    ) -> SceneGeometry:
        """Look at the given geom and flex groups of a model from now on; see `SceneGeometry.from_model`."""
        geometry = SceneGeometry.from_model(model, groups=groups, rng=rng)
        self.attach_geometry(geometry)
        return geometry

    def attach_geometry(self, geometry: SceneGeometry) -> None:
        """Look at a scene of triangles from now on."""
        self._scene = RayScene(geometry, self._device)
        self._tracer.attach(self._scene)

    def capture(
        self, data: mujoco.MjData | None, world_from_camera: NDArray[np.float64], rng: np.random.Generator | None
    ) -> StripeCapture:
        """Take an image of the scene as it is now.

        Args:
            data: State of the attached model, its kinematics current; None leaves the scene's points where they are.
            world_from_camera: 4x4, computer-vision camera. The projector follows from the rig.
            rng: Source of the shot and read noise; None takes the expected image.

        Raises:
            InvalidValueError: If no scene is attached or the pose is not a rigid transform.
        """
        self._prepare(data, world_from_camera)
        if rng is None:
            self._noise.zero_()
        else:
            self._noise.assign(rng.standard_normal(self._noise.size, dtype=np.float32))
        self._runner.run(self._tracer.trace, self._shade)
        view = self._tracer.read()
        image = self._image.numpy().reshape(self._shape).copy()
        electrons = self._electrons.numpy().reshape(self._shape).copy()
        return StripeCapture(**vars(view), image=image, electrons=electrons)

    def exact(self, data: mujoco.MjData | None, world_from_camera: NDArray[np.float64]) -> ExactView:
        """Return only what geometry says, without an image; arguments and errors as for `capture`."""
        self._prepare(data, world_from_camera)
        self._runner.run(self._tracer.trace)
        return self._tracer.read()

    def _prepare(self, data: mujoco.MjData | None, world_from_camera: NDArray[np.float64]) -> None:
        """Bring the scene and the camera's pose to the device and find what is seen."""
        if self._scene is None:
            raise InvalidValueError("scene", None, "a scene that was attached before the first image")
        self._tracer.place(world_from_camera)
        if data is not None:
            self._scene.geometry.update(data)
        self._scene.update()
        self._tracer.find_surfaces()

    def _projection(self) -> Any:
        """Gather the projector's numbers for the kernels."""
        optics, mask, table = self._optics, self.rig.mask, self._mask_table
        projector_from_camera = self.rig.projector_from_camera
        projection = kernels.Projection()
        projection.rotation = wp.mat33(*projector_from_camera[:3, :3].ravel())
        projection.offset = wp.vec3(*projector_from_camera[:3, 3])
        projection.half_height = mask.half_width_tan
        projection.intensity_w_sr = optics.axial_intensity_w_sr(mask)
        projection.led_exponent = optics.led_exponent
        projection.stray_fraction = optics.stray_fraction
        projection.fixed_variance = optics.fixed_blur_tan(self.rig.camera.fx) ** 2
        projection.defocus_slope = optics.projector_aperture_m / 4.0
        projection.inverse_focus = 1.0 / optics.projector_focus_m
        projection.table_x_min = table.x_min
        projection.table_x_step = table.x_step
        projection.table_sigma_step = table.sigma_step
        return projection

    def _sensor(self) -> Any:
        """Gather the lens's and the sensor's numbers for the kernels."""
        optics = self._optics
        sensor = kernels.Sensor()
        sensor.electrons_per_radiance = optics.electrons_per_radiance
        sensor.vignetting_exponent = optics.vignetting_exponent
        sensor.full_well = optics.full_well_electrons
        sensor.read_variance = optics.read_noise_electrons**2
        sensor.levels = float(2**optics.bits - 1)
        return sensor
