"""A scene's triangles on a Warp device, with the tree that rays walk through."""

from typing import Any

import warp as wp

from laploop.envs.sensors.kernels import ray_kernels
from laploop.envs.sensors.tracing.scene_geometry import SceneGeometry


class RayScene:
    """Points, triangles, vertex normals and bounding-volume tree of one `SceneGeometry` on a device."""

    def __init__(self, geometry: SceneGeometry, device: wp.Device) -> None:
        """Upload the scene and build its tree; call `update` before tracing if the points have moved since."""
        self.geometry = geometry
        self.device = device
        self.points: Any = wp.array(geometry.points, dtype=wp.vec3, device=device, copy=True)
        self.corners: Any = wp.array(geometry.triangles.ravel(), dtype=wp.int32, device=device)
        # Triangles of one part stay together in the tree, so that it fits as well after the parts have moved.
        parts: Any = wp.array(geometry.parts, dtype=wp.int32, device=device)
        self.mesh: Any = wp.Mesh(points=self.points, indices=self.corners, groups=parts)
        self.object_ids: Any = wp.array(geometry.object_ids, dtype=wp.uint8, device=device)
        self.albedo_factor: Any = wp.array(geometry.albedo_factor, dtype=wp.float32, device=device)
        offsets, order = geometry.corners_around_vertices()
        self._offsets: Any = wp.array(offsets, dtype=wp.int32, device=device)
        self._order: Any = wp.array(order, dtype=wp.int32, device=device)
        self.normals: Any = wp.zeros(len(geometry.points), dtype=wp.vec3, device=device)
        self._normals_launch = wp.launch(
            ray_kernels.vertex_normals,
            dim=len(geometry.points),
            inputs=[self.points, self.corners, self._offsets, self._order],
            outputs=[self.normals],
            device=device,
            record_cmd=True,
        )
        self.update()

    def update(self) -> None:
        """Upload the geometry's points, refit the tree and compute the vertex normals anew."""
        self.points.assign(self.geometry.points)
        self.mesh.refit()
        self._normals_launch.launch()
