"""Soft borders of shadows: buffers and recorded launches."""

import math
from typing import Any

import numpy as np
import warp as wp

from laploop.arrays import Array
from laploop.envs.sensors.kernels import shadow_kernels
from laploop.envs.sensors.optics.device_optics import DeviceOptics
from laploop.envs.sensors.tracing.strip_runner import launch_run
from laploop.envs.sensors.tracing.view_tracer import RayScene, ViewTracer

_RAYS = 32


class SoftShadows:
    """Finds which fraction of the projector's light reaches each pixel's point.

    Attributes:
        visible: Device array, the fraction, 0 to 1.
    """

    def __init__(self, tracer: ViewTracer, count: int, device: Any, optics: DeviceOptics) -> None:
        """Allocate the buffers.

        Args:
            tracer: Finds the surfaces.
            count: Pixels of the camera.
            device: A Warp device.
            optics: The projector's light.
        """
        self._tracer = tracer
        self._optics = optics
        self.visible: Any = wp.zeros(count, dtype=wp.float32, device=device)
        self._borders: Any = wp.zeros(len(tracer.projector_keys), dtype=wp.float32, device=device)
        self._disk: Any = wp.array(_disk_points(_RAYS).ravel(), dtype=wp.float32, device=device)
        run = launch_run(device)
        self._mark = wp.launch(
            shadow_kernels.mark_borders,
            dim=math.ceil(len(tracer.projector_keys) / run),
            inputs=[run, tracer.projector.view, optics.projection, tracer.projector_keys],
            outputs=[self._borders],
            device=device,
            record_cmd=True,
        )
        depth, _, tangent, flags, _, _ = tracer.outputs
        inputs = [depth, tracer.rays, tangent, flags, tracer.projector, optics.projection, self._borders]
        self._find = tracer.record(shadow_kernels.find_penumbra, inputs, [self.visible])

    def mark_borders(self) -> None:
        """Find the borders of shadows on the projector's depth map; run the stages of `record` afterwards."""
        self._borders.zero_()
        self._mark.launch()

    def record(self, scene: RayScene) -> list[list[Any]]:
        """Record the launches for the scene that the tracer has been attached to; they follow those of `ViewTracer.trace`."""
        tracer, optics = self._tracer, self._optics
        depth, normal, tangent, _, _, _ = tracer.outputs
        inputs = [tracer.rays, depth, normal, tangent, tracer.projector_keys, self._borders]
        inputs += [tracer.in_projector, scene.corners, scene.offsets, scene.pairs, tracer.projector, self._disk]
        inputs += [optics.table, optics.stack, optics.projection]
        return [self._find, tracer.record(shadow_kernels.settle_penumbra, inputs, [self.visible])]


def _disk_points(count: int) -> Array:
    """Return points that fill the unit disk evenly, (count, 2): a sunflower's (Vogel 1979)."""
    number = np.arange(count)
    radius, angle = np.sqrt((number + 0.5) / count), number * math.pi * (3.0 - math.sqrt(5.0))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
