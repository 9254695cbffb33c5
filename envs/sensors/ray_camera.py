"""What cameras that follow rays through a scene have in common."""

from collections.abc import Collection

import mujoco
import numpy as np
from numpy.typing import NDArray

from laploop.assets.tissue_appearance import TissueAppearance
from laploop.envs.sensors.stripe_capture import DepthView, ExactView
from laploop.envs.sensors.tracing.device import open_device
from laploop.envs.sensors.tracing.scene_geometry import SceneGeometry
from laploop.envs.sensors.tracing.scene_snapshot import SceneSnapshot
from laploop.envs.sensors.tracing.strip_runner import StripRunner
from laploop.envs.sensors.tracing.tissue_surface import TissueSurface
from laploop.envs.sensors.tracing.view_tracer import RayScene, ViewTracer
from laploop.errors import InvalidValueError
from laploop.perception.geometry import Intrinsics, Rig, rigid_transform


class RayCamera:
    """A camera and a projector that follow one ray a pixel to the surface and back to the projector.

    Buffers are allocated once; what a camera returns is the caller's own.
    """

    def __init__(self, rig: Rig, device: str = "cpu", threads: int | None = None) -> None:
        """Allocate the buffers and compile the kernels; `attach` a scene before the first image.

        Args:
            rig: Geometry of camera, projector and mask.
            device: A Warp device: "cpu", "cuda", "cuda:0", ...
            threads: CPU threads that share an image; by default two where there are two cores.

        Raises:
            UnknownNameError: If there is no such device.
            OutputError: If compiled kernels cannot be kept.
            InvalidValueError: If the number of threads is not from 1 to 64.
        """
        self.rig = rig
        self._device = open_device(device)
        self._runner = StripRunner(self._device, threads)
        self._tracer = ViewTracer(rig, self._device, self._runner)
        self._scene: RayScene | None = None
        self._traced: SceneSnapshot | None = None
        """The moment whose geometry the tracer's buffers hold."""

    @property
    def intrinsics(self) -> Intrinsics:
        """Intrinsics of the camera."""
        return self.rig.camera

    def attach(
        self,
        model: mujoco.MjModel,
        *,
        tissue: TissueSurface | None = None,
        groups: Collection[int] = (1,),
        without: Collection[str] = (),
        rng: np.random.Generator | None = None,
        appearance: TissueAppearance | None = None,
    ) -> SceneGeometry:
        """Look at a tissue and the given groups of a model from now on; see `SceneGeometry.from_model`.

        The default leaves out arms and abdominal wall.
        """
        geometry = SceneGeometry.from_model(
            model, tissue=tissue, groups=groups, without=without, rng=rng, appearance=appearance
        )
        self.attach_geometry(geometry)
        return geometry

    def attach_geometry(self, geometry: SceneGeometry) -> None:
        """Look at a scene of triangles from now on."""
        self._scene = RayScene(geometry, self._device)
        self._tracer.attach(self._scene)
        self._traced = None

    def close(self) -> None:
        """End the threads; the camera stays usable, on one."""
        self._runner.close()

    def exact(self, data: mujoco.MjData | None, world_from_camera: NDArray[np.float64]) -> ExactView:
        """Return the geometry of the scene as it is now, without an image.

        Args:
            data: State of the attached model, its kinematics current; None leaves the scene's points where they are.
            world_from_camera: 4x4, computer-vision camera. The projector follows from the rig.

        Raises:
            InvalidValueError: If no scene is attached or the pose is not a rigid transform.
        """
        return self.exact_view(self.snapshot(data, world_from_camera))

    def snapshot(self, data: mujoco.MjData | None, world_from_camera: NDArray[np.float64]) -> SceneSnapshot:
        """Return a copy of what moves, for `depth_view` or `exact_view` later on; arguments and errors as for `exact`."""
        geometry = self._attached().geometry
        pose = rigid_transform("world_from_camera", world_from_camera)
        if data is not None:
            geometry.update(data)
        return SceneSnapshot(points=geometry.points.copy(), world_from_camera=pose)

    def depth_view(self, snapshot: SceneSnapshot) -> DepthView:
        """Return the exact depth at a moment of the attached scene: several times cheaper than `exact_view`."""
        scene = self._attached()
        self._traced = None
        self._tracer.place(snapshot.world_from_camera)
        scene.move(snapshot.points)
        self._tracer.find_camera_surfaces()
        return self._tracer.read_depth()

    def exact_view(self, snapshot: SceneSnapshot) -> ExactView:
        """Return the geometry at a moment of the attached scene."""
        self._find_surfaces(snapshot)
        self._runner.run(*self._tracer.trace)
        self._traced = snapshot
        return self._tracer.read()

    def _find_surfaces(self, snapshot: SceneSnapshot) -> None:
        """Bring a moment to the device and find the triangle behind each pixel of the camera and the projector."""
        scene = self._attached()
        self._traced = None
        self._tracer.place(snapshot.world_from_camera)
        scene.move(snapshot.points)
        self._tracer.find_surfaces()

    def _attached(self) -> RayScene:
        if self._scene is None:
            raise InvalidValueError("scene", None, "a scene that was attached before the first image")
        return self._scene
