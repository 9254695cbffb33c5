"""The laparoscope's camera and projector channel, ray cast."""

import itertools
import os
from collections.abc import Callable, Collection
from concurrent.futures import ThreadPoolExecutor

import mujoco
import numpy as np
import warp as wp
from numpy.typing import NDArray

from laploop.envs.sensors import kernels
from laploop.envs.sensors.mask_table import MaskTable
from laploop.envs.sensors.ray_scene import RayScene, open_device
from laploop.envs.sensors.scene_geometry import SceneGeometry
from laploop.envs.sensors.stripe_capture import ExactView, StripeCapture
from laploop.envs.sensors.stripe_optics import StripeOptics
from laploop.errors import InvalidValueError
from laploop.perception.geometry import Rig

_STRIPS_PER_THREAD = 4


class StripeCamera:
    """Renders what the camera channel sees of a scene that the projector channel lights through its mask.

    One ray a pixel finds the surface, one ray from the projector's centre tells whether its light gets there, and a radiometric
    model (`StripeOptics`) makes electrons and grey values of it. All buffers are allocated once; results are copies.
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
        if threads is None:
            threads = min(2, len(os.sched_getaffinity(0)))
        if not 1 <= threads <= 64:
            raise InvalidValueError("threads", threads, "1 to 64")
        self.rig = rig
        self._device = open_device(device)
        self._threads = threads if self._device.is_cpu else 1
        self._helpers = ThreadPoolExecutor(max_workers=self._threads - 1) if self._threads > 1 else None
        self._scene: RayScene | None = None
        self._trace: list[wp.Launch] = []
        self._shade: list[wp.Launch] = []
        self._shape = (rig.camera.height, rig.camera.width)
        count = rig.camera.height * rig.camera.width
        self._bounds = self._split(count)
        rays = rig.camera.rays[..., :2].reshape(-1, 2).astype(np.float32)
        self._rays = wp.array(rays, dtype=wp.vec2, device=self._device)
        self._pose = wp.zeros(5, dtype=wp.vec3, device=self._device)
        self._depth = wp.zeros(count, dtype=wp.float32, device=self._device)
        self._normals = wp.zeros(count, dtype=wp.vec3, device=self._device)
        self._projector = wp.zeros(count, dtype=wp.vec2, device=self._device)
        self._flags = wp.zeros(count, dtype=wp.uint8, device=self._device)
        self._object_id = wp.zeros(count, dtype=wp.uint8, device=self._device)
        self._factor = wp.zeros(count, dtype=wp.float32, device=self._device)
        self._noise = wp.zeros(count, dtype=wp.float32, device=self._device)
        self._electrons = wp.zeros(count, dtype=wp.float32, device=self._device)
        self._image = wp.zeros(count, dtype=wp.uint8, device=self._device)
        self._no_noise = np.zeros(count, dtype=np.float32)
        table = MaskTable.from_mask(rig.mask)
        self._table = wp.array(table.transmission, dtype=wp.float32, device=self._device)
        self._table_grid = table
        self.set_optics(optics or StripeOptics())

    @property
    def optics(self) -> StripeOptics:
        """The optical model in use."""
        return self._optics

    def set_optics(self, optics: StripeOptics) -> None:
        """Change the optical model; cheap enough to do before every image."""
        self._optics = optics
        self._materials = wp.array(optics.material_table, dtype=wp.vec4, device=self._device)
        self._record_shading()

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
        self._record_tracing()

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
            self._noise.assign(self._no_noise)
        else:
            self._noise.assign(rng.standard_normal(len(self._no_noise), dtype=np.float32))
        self._launch(self._trace, self._shade)
        view = self._read_view()
        return StripeCapture(**vars(view), image=self._read(self._image), electrons=self._read(self._electrons))

    def exact(self, data: mujoco.MjData | None, world_from_camera: NDArray[np.float64]) -> ExactView:
        """Return only what geometry says, without an image; arguments and errors as for `capture`."""
        self._prepare(data, world_from_camera)
        self._launch(self._trace)
        return self._read_view()

    def _prepare(self, data: mujoco.MjData | None, world_from_camera: NDArray[np.float64]) -> None:
        """Bring the scene and the camera's pose to the device."""
        if self._scene is None:
            raise InvalidValueError("scene", None, "a scene that was attached before the first image")
        pose = np.asarray(world_from_camera, dtype=np.float64)
        rotation = pose[:3, :3]
        if pose.shape != (4, 4) or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) or not np.isfinite(pose).all():
            raise InvalidValueError("world_from_camera", world_from_camera, "a rigid 4x4 transform")
        if data is not None:
            self._scene.geometry.update(data)
        self._scene.update()
        projector_from_camera = self.rig.projector_from_camera
        projector_in_camera = -projector_from_camera[:3, :3].T @ projector_from_camera[:3, 3]
        rows = np.vstack([pose[:3, 3], rotation.T, rotation @ projector_in_camera + pose[:3, 3]])
        self._pose.assign(rows.astype(np.float32))

    def _split(self, count: int) -> list[tuple[int, int]]:
        """Cut the image into strips of (first, number of pixels), several a thread so that none waits long."""
        strips = self._threads * _STRIPS_PER_THREAD if self._threads > 1 else 1
        edges = np.linspace(0, count, strips + 1).astype(int)
        return [(int(a), int(b - a)) for a, b in itertools.pairwise(edges)]

    def _record(self, kernel: wp.Kernel, inputs: list[object], outputs: list[wp.array]) -> list[wp.Launch]:
        """Record a launch of `kernel` for each strip."""
        return [
            wp.launch(kernel, dim=size, inputs=[first, *inputs], outputs=outputs, device=self._device, record_cmd=True)
            for first, size in self._bounds
        ]

    def _record_tracing(self) -> None:
        """Record the launches that depend on the scene."""
        scene = self._scene
        if scene is None:
            return
        self._trace = self._record(
            kernels.trace,
            [
                scene.mesh.id,
                self._pose,
                self._rays,
                scene.corners,
                scene.object_ids,
                scene.normals,
                scene.albedo_factor,
                self._projection(),
            ],
            [self._depth, self._normals, self._projector, self._flags, self._object_id, self._factor],
        )

    def _record_shading(self) -> None:
        """Record the launches that depend on the optics."""
        optics = self._optics
        sensor = kernels.Sensor()
        sensor.electrons_per_radiance = optics.electrons_per_radiance
        sensor.vignetting_exponent = optics.vignetting_exponent
        sensor.full_well = optics.full_well_electrons
        sensor.read_variance = optics.read_noise_electrons**2
        sensor.levels = float(2**optics.bits - 1)
        inputs = [self._rays, self._depth, self._normals, self._projector, self._flags, self._object_id, self._factor]
        inputs += [self._materials, self._table, self._projection(), sensor, self._noise]
        self._shade = self._record(kernels.shade, inputs, [self._electrons, self._image])

    def _projection(self) -> object:
        """Gather the projector's numbers for the kernels."""
        optics, mask = self._optics, self.rig.mask
        projector_from_camera = self.rig.projector_from_camera
        projection = kernels.Projection()
        projection.rotation = wp.mat33(*projector_from_camera[:3, :3].ravel())
        projection.offset = wp.vec3(*projector_from_camera[:3, 3])
        projection.half_field = wp.vec2(mask.half_width_tan, mask.half_width_tan)
        projection.intensity_w_sr = optics.axial_intensity_w_sr(mask)
        projection.led_exponent = optics.led_exponent
        projection.stray_fraction = optics.stray_fraction
        projection.fixed_variance = optics.fixed_blur_tan(self.rig.camera.fx) ** 2
        projection.defocus_slope = optics.projector_aperture_m / 4.0
        projection.inverse_focus = 1.0 / optics.projector_focus_m
        projection.table_x_min = self._table_grid.x_min
        projection.table_x_step = self._table_grid.x_step
        projection.table_sigma_step = self._table_grid.sigma_step
        return projection

    def _launch(self, *stages: list[wp.Launch]) -> None:
        """Run the stages on every strip; on the CPU the threads take strip after strip until none is left."""
        strips = list(zip(*stages, strict=True))
        turn = itertools.count()

        def work() -> None:
            while (number := next(turn)) < len(strips):
                for launch in strips[number]:
                    launch.launch()

        helpers = [self._helpers.submit(work) for _ in range(self._threads - 1)] if self._helpers else []
        work()
        for helper in helpers:
            helper.result()

    def _read_view(self) -> ExactView:
        """Copy the geometry's results."""
        flags = self._flags.numpy().reshape(self._shape)
        projector = self._projector.numpy().reshape(*self._shape, 2)
        both = kernels.LINE_OF_SIGHT | kernels.INSIDE_FIELD
        return ExactView(
            depth_mm=self._depth.numpy().reshape(self._shape) * np.float32(1e3),
            normals=self._read(self._normals, 3),
            projector_x=np.ascontiguousarray(projector[..., 0]),
            projector_y=np.ascontiguousarray(projector[..., 1]),
            lit=flags == both,
            object_id=self._read(self._object_id),
        )

    def _read(self, array: wp.array, *channels: int) -> NDArray[np.generic]:
        """Copy a device array as an image."""
        return array.numpy().reshape(*self._shape, *channels).copy()
