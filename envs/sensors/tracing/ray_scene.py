"""A scene's triangles on a Warp device, with the tree that rays walk through."""

import contextlib
import os
from collections.abc import Iterator
from typing import Any

import warp as wp

from laploop.envs.sensors.kernels import ray_kernels, shading_kernels, zbuffer_kernels
from laploop.envs.sensors.tracing.scene_geometry import SceneGeometry
from laploop.errors import InvalidValueError


@contextlib.contextmanager
def quiet_warp() -> Iterator[None]:
    """Keep Warp's greeting and its notes about compiling to itself inside the block."""
    before = wp.config.log_level
    wp.config.log_level = max(before, wp.LOG_ERROR)
    try:
        with _without_driver_warning():
            wp.get_devices()
        yield
    finally:
        wp.config.log_level = before


@contextlib.contextmanager
def _without_driver_warning() -> Iterator[None]:
    """Hold back the line that Warp's library prints where there is no GPU, and no other; no option turns it off."""
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    standard_error = os.dup(2)
    os.dup2(writer, 2)
    os.close(writer)
    try:
        yield
    finally:
        os.dup2(standard_error, 2)
        os.close(standard_error)
        with os.fdopen(reader, "rb") as printed:
            lines = [line for line in printed if b"Could not find or load the NVIDIA CUDA driver" not in line]
        if lines:
            os.write(2, b"".join(lines))


def open_device(name: str) -> wp.Device:
    """Return a Warp device with our kernels compiled for it (seconds the first time, then cached for the user).

    Raises:
        InvalidValueError: If there is no such device.
    """
    with quiet_warp():
        available = [device.alias for device in wp.get_devices()]
        if wp.is_cuda_available():
            available.append("cuda")
        if name not in available:
            raise InvalidValueError("device", name, f"one of {available}")
        device = wp.get_device(name)
        for module in (ray_kernels, shading_kernels, zbuffer_kernels):
            wp.load_module(module, device=device)
    return device


class RayScene:
    """Points, triangles, vertex normals and bounding-volume tree of one `SceneGeometry` on a device."""

    def __init__(self, geometry: SceneGeometry, device: wp.Device) -> None:
        """Upload the scene and build its tree; `update` before tracing if the points have moved since."""
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
