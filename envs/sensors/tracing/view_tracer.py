"""A scene on a Warp device, and the exact geometry of what a camera sees of it and a projector reaches."""

import math
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from laploop.envs.sensors.kernels import ray_kernels, zbuffer_kernels
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.stripe_capture import DepthView, ExactView
from laploop.envs.sensors.tracing.scene_geometry import SceneGeometry
from laploop.envs.sensors.tracing.strip_runner import StripRunner, launch_run
from laploop.perception.geometry import Rig, invert_transform

_NOTHING = 2**64 - 1
_PROJECTOR_MARGIN_TAN = 0.08
"""How far the projector's depth map reaches beyond the mask, so that its blurred border is covered too."""
_LARGEST_HALF_MAP = 2048
"""Half the width of the projector's depth map at most, pixels: 134 MB; where it is too coarse, rays decide."""


class RayScene:
    """Points, triangles and bounding-volume tree of one `SceneGeometry` on a device."""

    def __init__(self, geometry: SceneGeometry, device: wp.Device) -> None:
        """Upload the scene and build its tree."""
        self.geometry = geometry
        self.device = device
        self.points: Any = wp.array(geometry.points, dtype=wp.vec3, device=device, copy=True)
        self.corners: Any = wp.array(geometry.triangles.ravel(), dtype=wp.int32, device=device)
        # Triangles of one part stay together in the tree, so that it fits as well after the parts have moved.
        parts: Any = wp.array(geometry.parts, dtype=wp.int32, device=device)
        self.mesh: Any = wp.Mesh(points=self.points, indices=self.corners, groups=parts)
        self.object_ids: Any = wp.array(geometry.object_ids, dtype=wp.uint8, device=device)
        self.albedo_factor: Any = wp.array(geometry.albedo_factor, dtype=wp.float32, device=device)
        offsets, pairs = geometry.neighbours()
        self.offsets: Any = wp.array(offsets, dtype=wp.int32, device=device)
        self.pairs: Any = wp.array(pairs, dtype=wp.vec2i, device=device)

    def move(self, points: NDArray[np.float32]) -> None:
        """Upload the points, (n, 3) in the world, and refit the tree."""
        self.points.assign(points)
        self.mesh.refit()

    def record_normals(self, points: Any, normals: Any) -> Any:
        """Record the launch that computes the vertex normals, from the points and to the normals, in any one frame."""
        count, run = len(points), launch_run(self.device)
        return wp.launch(
            ray_kernels.vertex_normals,
            dim=math.ceil(count / run),
            inputs=[count, run, points, self.offsets, self.pairs],
            outputs=[normals],
            device=self.device,
            record_cmd=True,
        )


class ViewTracer:
    """Device buffers and recorded launches that follow each pixel's ray to the surface and back to the projector.

    Attributes:
        rays: Device array, tangent coordinates of the rays.
        projector: The `Projector` of the kernels.
        outputs: Device arrays, an entry a pixel, that `trace` writes: depth, normal, tangent, flags, object id, albedo factor.
        projector_keys: Device array, the projector's depth map.
        in_projector: Device array, the scene's vertices in the projector's frame.
    """

    def __init__(self, rig: Rig, device: Any, runner: StripRunner) -> None:
        camera = rig.camera
        self._rig = rig
        self._device = device
        self._runner = runner
        self._shape = (camera.height, camera.width)
        count = camera.height * camera.width
        directions = camera.rays[..., :2].reshape(-1, 2).astype(np.float32)
        self.rays: Any = wp.array(directions, dtype=wp.vec2, device=device)
        self._pose: Any = wp.zeros(5, dtype=wp.vec3, device=device)
        self._camera_view = _view(self._shape, (camera.fx, camera.fy), (camera.cx, camera.cy))
        half_tan = rig.mask.half_width_tan + _PROJECTOR_MARGIN_TAN
        half = min(math.ceil(half_tan * camera.fx), _LARGEST_HALF_MAP)
        focal = min(camera.fx, half / half_tan)
        self._projector_view = _view((2 * half, 2 * half), (focal, focal), (half, half))
        self._projector_in_camera = invert_transform(rig.projector_from_camera)[:3, 3]
        self.projector = _projector(rig, self._projector_view)
        self._camera_keys: Any = wp.zeros(count, dtype=wp.uint64, device=device)
        self.projector_keys: Any = wp.zeros(4 * half * half, dtype=wp.uint64, device=device)
        kinds = (wp.float32, wp.vec3, wp.vec2, wp.uint8, wp.uint8, wp.float32)
        self.outputs: list[Any] = [wp.zeros(count, dtype=kind, device=device) for kind in kinds]
        self.in_projector: Any = None
        self._pinhole = True
        self._walk: list[Any] = []
        self._walk_inputs: list[Any] = []
        self._to_views: Any = None
        self._to_normals: Any = None
        self._rasterise_camera: list[Any] = []
        self._rasterise_projector: list[Any] = []
        self._object_ids: NDArray[np.uint8] = np.zeros(1, dtype=np.uint8)
        self.trace: list[list[Any]] = []
        """Recorded launches of each stage, one for each of `StripRunner.pixel_strips`; run them after `find_surfaces`."""

    def set_rays(self, rays: NDArray[np.float64]) -> None:
        """Follow rays other than the rig's pinhole's, (height, width, 3) with z = 1, such as those of a distorting lens.

        Surfaces are then found in the scene's tree, about ten times slower than for a pinhole.
        """
        self._pinhole = rays is self._rig.camera.rays
        self.rays.assign(rays[..., :2].reshape(-1, 2).astype(np.float32))

    def attach(self, scene: RayScene) -> None:
        """Look at a scene from now on."""
        device = self._device
        count = len(scene.points)
        in_camera = wp.zeros(count, dtype=wp.vec3, device=device)
        on_camera = wp.zeros(count, dtype=wp.vec2, device=device)
        in_projector = wp.zeros(count, dtype=wp.vec3, device=device)
        on_projector = wp.zeros(count, dtype=wp.vec2, device=device)
        self._to_views = wp.launch(
            zbuffer_kernels.to_views,
            dim=count,
            inputs=[scene.points, self._pose, self._camera_view, self.projector],
            outputs=[in_camera, on_camera, in_projector, on_projector],
            device=device,
            record_cmd=True,
        )
        self.in_projector = in_projector
        corners = scene.corners
        normals = wp.zeros(count, dtype=wp.vec3, device=device)
        self._to_normals = scene.record_normals(in_camera, normals)
        self._rasterise_camera = self._record_rasterise(self._camera_view, in_camera, on_camera, corners, self._camera_keys)
        self._rasterise_projector = self._record_rasterise(
            self._projector_view, in_projector, on_projector, corners, self.projector_keys
        )
        # The last entry stands for what is not hit.
        self._object_ids = np.append(scene.geometry.object_ids, np.uint8(ObjectId.BACKGROUND))
        self._walk, self._walk_inputs = [], [scene.mesh.id, self._pose, self.rays, in_camera, scene.corners]
        inputs = [self.rays, self._camera_keys, self.projector_keys, self.projector]
        inputs += [corners, in_camera, normals, scene.albedo_factor, scene.object_ids]
        depth, _, _, flags, _, _ = self.outputs
        self.trace = [
            self.record(ray_kernels.trace, inputs, self.outputs),
            self.record(ray_kernels.settle, [scene.mesh.id, self._pose, self.rays, depth], [flags]),
        ]

    def record(self, kernel: Any, inputs: list[Any], outputs: list[Any]) -> list[Any]:
        """Record a launch of a kernel over pixels for each strip; its first arguments are the strip's ends and the run."""
        run = launch_run(self._device)
        return [
            wp.launch(
                kernel,
                dim=math.ceil(size / run),
                inputs=[first, first + size, run, *inputs],
                outputs=outputs,
                device=self._device,
                record_cmd=True,
            )
            for first, size in self._runner.pixel_strips(self._shape[0] * self._shape[1])
        ]

    def place(self, world_from_camera: NDArray[np.float64]) -> None:
        """Move the camera, and with it the projector, to a rigid 4x4 pose."""
        rotation, centre = world_from_camera[:3, :3], world_from_camera[:3, 3]
        rows = np.empty((5, 3), dtype=np.float32)
        rows[0], rows[1:4], rows[4] = centre, rotation.T, rotation @ self._projector_in_camera + centre
        self._pose.assign(rows)

    def find_camera_surfaces(self) -> None:
        """Find the triangles behind the pixels of the camera."""
        self._camera_keys.fill_(_NOTHING)
        self._to_views.launch()
        if not self._pinhole and not self._walk:
            self._walk = self.record(ray_kernels.trace_keys, self._walk_inputs, [self._camera_keys])
        self._runner.run(self._rasterise_camera if self._pinhole else self._walk)

    def find_surfaces(self) -> None:
        """Find the triangles behind the pixels of the camera and of the projector's depth map, and the vertices' normals."""
        self.find_camera_surfaces()
        self._to_normals.launch()
        self.projector_keys.fill_(_NOTHING)
        self._runner.run(self._rasterise_projector)

    def read_depth(self) -> DepthView:
        """Decode what `find_camera_surfaces` has found: depth in the upper half of a key, the triangle in the lower."""
        keys = self._camera_keys.numpy()
        # Where nothing was hit, all bits are set: a depth that is not a number.
        depth = (keys >> np.uint64(32)).astype(np.uint32).view(np.float32) * np.float32(1e3)
        triangle = np.minimum(keys.astype(np.uint32), np.uint32(len(self._object_ids) - 1))
        return DepthView(depth_mm=depth.reshape(self._shape), object_id=self._object_ids[triangle].reshape(self._shape))

    def read(self) -> ExactView:
        """Copy the results to numpy."""
        depth, normals, projector, flags, object_id, _ = (values.numpy() for values in self.outputs)
        projector = projector.reshape(*self._shape, 2)
        both = ray_kernels.LINE_OF_SIGHT | ray_kernels.INSIDE_FIELD
        return ExactView(
            depth_mm=depth.reshape(self._shape) * np.float32(1e3),
            normals=normals.reshape(*self._shape, 3).copy(),
            projector_x=np.ascontiguousarray(projector[..., 0]),
            projector_y=np.ascontiguousarray(projector[..., 1]),
            lit=flags.reshape(self._shape) == both,
            object_id=object_id.reshape(self._shape).copy(),
        )

    def _record_rasterise(self, view: Any, vertices: Any, pixels: Any, corners: Any, keys: Any) -> list[Any]:
        """Record the search for the nearest triangles, a launch a group of row strips."""
        groups, run = self._runner.row_strips(), launch_run(self._device)
        rows = math.ceil(view.height / sum(size for _, size in groups))
        return [
            wp.launch(
                zbuffer_kernels.rasterise,
                dim=(size, math.ceil(corners.size // 3 / run)),
                inputs=[first, rows, run, view, vertices, pixels, corners],
                outputs=[keys],
                device=self._device,
                record_cmd=True,
            )
            for first, size in groups
        ]


def _view(shape: tuple[int, int], focal: tuple[float, float], centre: tuple[float, float]) -> Any:
    """Pack a pinhole's numbers for the kernels."""
    view = zbuffer_kernels.View()
    view.height, view.width = shape
    view.focal = wp.vec2(*focal)
    view.step = wp.vec2(1.0 / focal[0], 1.0 / focal[1])
    view.centre = wp.vec2(*centre)
    return view


def _projector(rig: Rig, view: Any) -> Any:
    """Pack the projector's numbers for the kernels."""
    projector_from_camera = rig.projector_from_camera
    projector = zbuffer_kernels.Projector()
    projector.rotation = wp.mat33(*projector_from_camera[:3, :3].ravel())
    projector.offset = wp.vec3(*projector_from_camera[:3, 3])
    projector.centre = wp.vec3(*invert_transform(projector_from_camera)[:3, 3])
    projector.axis = wp.vec3(*projector_from_camera[2, :3])
    projector.half_field = rig.mask.half_width_tan
    projector.view = view
    return projector
