"""Soft borders of shadows: buffers and recorded launches."""

import math
from typing import Any

import numpy as np
import warp as wp

from laploop.arrays import Array
from laploop.envs.sensors.kernels import shadow_kernels
from laploop.envs.sensors.tracing.strip_runner import launch_run
from laploop.envs.sensors.tracing.view_tracer import ViewTracer

_RAYS = 16
_NARROWEST_PX = 0.3
"""Half width of a penumbra on the projector's depth map, below which it counts as sharp: a third of a pixel."""


class SoftShadows:
    """Finds which fraction of the projector's light reaches each pixel's point.

    Attributes:
        visible: Device array, the fraction, 0 to 1.
    """

    def __init__(self, tracer: ViewTracer, count: int, device: Any) -> None:
        self._tracer = tracer
        self._device = device
        self.visible: Any = wp.zeros(count, dtype=wp.float32, device=device)
        self._borders: Any = wp.zeros(len(tracer.projector_keys), dtype=wp.float32, device=device)
        self._mark: Any = None

    def mark_borders(self) -> None:
        """Find the borders of shadows on the projector's depth map; run the stages of `record` afterwards."""
        if self._mark is not None:
            self._borders.zero_()
            self._mark.launch()

    def record(self, radius_m: float, table: Any, stack: Any, projection: Any) -> list[list[Any]]:
        """Record the launches for an aperture's radius and the mask's light; they depend on `ViewTracer.trace` alone."""
        tracer = self._tracer
        view = tracer.projector.view
        radius = radius_m * max(view.focal[0], view.focal[1])
        least = _NARROWEST_PX / radius if radius > 0.0 else math.inf
        depth, normal, tangent, flags, _, _ = tracer.outputs
        inputs = [depth, tracer.rays, tangent, flags, tracer.projector, least, self._borders]
        stages = [tracer.record(shadow_kernels.find_penumbra, inputs, [self.visible])]
        self._mark = None
        if radius == 0.0 or not tracer.mesh:
            self._borders.zero_()
            return stages
        run = launch_run(self._device)
        self._mark = wp.launch(
            shadow_kernels.mark_borders,
            dim=math.ceil(len(tracer.projector_keys) / run),
            inputs=[run, view, least, radius, tracer.projector_keys],
            outputs=[self._borders],
            device=self._device,
            record_cmd=True,
        )
        points: Any = wp.array(radius_m * _disk_points(_RAYS), dtype=wp.vec2, device=self._device)
        inputs = [tracer.mesh, tracer.pose, tracer.rays, depth, normal, tangent, tracer.projector, points]
        inputs += [table, stack, projection]
        return [*stages, tracer.record(shadow_kernels.follow_penumbra, inputs, [self.visible])]


def _disk_points(count: int) -> Array:
    """Return points that fill the unit disk evenly, (count, 2): a sunflower's (Vogel 1979)."""
    number = np.arange(count)
    radius, angle = np.sqrt((number + 0.5) / count), number * math.pi * (3.0 - math.sqrt(5.0))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
