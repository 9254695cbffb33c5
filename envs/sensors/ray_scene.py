"""A scene's triangles on a Warp device, with the tree that rays walk through."""

import contextlib
from collections.abc import Iterator

import warp as wp

from laploop.envs.sensors import kernels
from laploop.envs.sensors.scene_geometry import SceneGeometry
from laploop.errors import InvalidValueError


@contextlib.contextmanager
def quiet_warp() -> Iterator[None]:
    """Keep Warp's greeting and its notes about compiling to itself inside the block."""
    before = wp.config.log_level
    wp.config.log_level = max(before, wp.LOG_WARNING)
    try:
        yield
    finally:
        wp.config.log_level = before


def open_device(name: str) -> wp.Device:
    """Return a Warp device with our kernels compiled for it (seconds the first time, then cached for the user).

    Raises:
        InvalidValueError: If there is no such device.
    """
    with quiet_warp():
        wp.init()
        available = [device.alias for device in wp.get_devices()]
        if name != "cuda" and name not in available or name == "cuda" and not wp.is_cuda_available():
            raise InvalidValueError("device", name, f"one of {available}")
        device = wp.get_device(name)
        wp.load_module(kernels, device=device)
    return device


class RayScene:
    """Points, triangles, vertex normals and bounding-volume tree of one `SceneGeometry` on a device."""

    def __init__(self, geometry: SceneGeometry, device: wp.Device) -> None:
        """Upload the scene and build its tree; `update` before tracing if the points have moved since."""
        self.geometry = geometry
        self.device = device
        self.points = wp.array(geometry.points, dtype=wp.vec3, device=device, copy=True)
        self.corners = wp.array(geometry.triangles.ravel(), dtype=wp.int32, device=device)
        # Triangles of one part stay together in the tree, so that it fits as well after the parts have moved.
        parts = wp.array(geometry.parts, dtype=wp.int32, device=device)
        self.mesh = wp.Mesh(points=self.points, indices=self.corners, groups=parts)
        self.object_ids = wp.array(geometry.object_ids, dtype=wp.uint8, device=device)
        self.albedo_factor = wp.array(geometry.albedo_factor, dtype=wp.float32, device=device)
        offsets, order = geometry.triangles_around_vertices()
        self._offsets = wp.array(offsets, dtype=wp.int32, device=device)
        self._order = wp.array(order, dtype=wp.int32, device=device)
        self.normals = wp.zeros(len(geometry.points), dtype=wp.vec3, device=device)
        self._normals_launch = wp.launch(
            kernels.vertex_normals,
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
