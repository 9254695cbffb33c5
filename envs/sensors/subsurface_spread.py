"""Light that spreads under surfaces: buffers and recorded launches."""

import math
from typing import Any

import numpy as np
import warp as wp

from laploop.arrays import Float32
from laploop.envs.sensors.kernels import spread_kernels
from laploop.envs.sensors.tracing.view_tracer import ViewTracer
from laploop.perception.geometry import Intrinsics

_END_SIGMAS = math.sqrt(11.0)
"""Where the weights of `spread_kernels.diffuse` end, in standard deviations."""
_FARTHEST_M = 0.15
"""Largest usual distance of tissue; beyond it, wide spreads may sample the narrower ones more coarsely than these are wide."""


class SubsurfaceSpread:
    """Spreads irradiance by each object's Gaussians, one on top of the other, along x and then along y.

    Light moves by distance on the surface and not between objects. A wide Gaussian adds to a narrower one, whose result is smooth
    enough for it to skip pixels.

    Attributes:
        result: Device array, irradiance after the spread.
    """

    def __init__(self, camera: Intrinsics, tracer: ViewTracer, device: Any) -> None:
        self._camera = camera
        self._tracer = tracer
        self._device = device
        count = camera.height * camera.width
        self._layer, self._distance, self._half, self._scale, self._total, self._sum, *self._turns = (
            wp.zeros(count, dtype=wp.float32, device=device) for _ in range(8)
        )
        self.result: Any = self._sum
        self._pixels = spread_kernels.Pixels()
        self._pixels.width, self._pixels.height = camera.width, camera.height
        self._pixels.start = wp.vec2((0.5 - camera.cx) / camera.fx, (0.5 - camera.cy) / camera.fy)
        self._pixels.step = wp.vec2(1.0 / camera.fx, 1.0 / camera.fy)
        corner = max(camera.cx, camera.width - camera.cx) / camera.fx, max(camera.cy, camera.height - camera.cy) / camera.fy
        self._oblique = math.sqrt(1.0 + max(corner) ** 2)

    def record(self, irradiance: Any, table: Float32) -> list[list[list[Any]]]:
        """Record the launches for `StripeOptics.subsurface_table`: stages, each of which needs all of the one before."""
        self.result = irradiance
        widths = table[..., 1].astype(np.float64)
        if not widths.any():
            return []
        depth, _, _, _, object_id, _ = self._tracer.outputs
        record = self._tracer.record
        alone = len(table) == 1
        inputs = [depth, object_id, irradiance]
        stages = [[record(spread_kernels.find_layers, inputs, [self._layer, self._distance, self._sum])]]
        source = irradiance
        for number in range(len(table)):
            narrower = widths[number - 1] if number else np.zeros_like(widths[0])
            added = np.sqrt(np.maximum(widths[number] ** 2 - narrower**2, 0.0))
            gaussians = wp.array(np.stack([table[number, :, 0], added], axis=1), dtype=wp.vec2, device=self._device)
            smooth = narrower[added > 0.0].min(initial=np.inf)
            target = self._turns[number % 2]
            stages += self._record_gaussian(gaussians, float(added.max()), float(smooth), object_id, source, target)
            if not alone:
                stages[-1].append(record(spread_kernels.add_spread, [gaussians, object_id, target], [self._sum]))
            source = target
        self.result = source if alone else self._sum
        return stages

    def _record_gaussian(
        self, gaussians: Any, widest: float, smooth: float, object_id: Any, source: Any, target: Any
    ) -> list[list[list[Any]]]:
        """Record one Gaussian on top of a source that is as smooth as a standard deviation in metres."""
        stages = []
        for along_x, focal, before, after in (
            (True, self._camera.fx, source, self._half),
            (False, self._camera.fy, self._half, target),
        ):
            stride = max(1, int(smooth * focal / _FARTHEST_M))
            reach = _END_SIGMAS * widest * focal / stride * self._oblique
            inputs = [gaussians, reach, stride, along_x, self._pixels, object_id, self._layer, self._distance, before]
            stages.append([self._tracer.record(spread_kernels.diffuse, inputs, [self._scale, self._total, after])])
        return stages
