"""Light that spreads under surfaces: buffers and recorded launches."""

import math
from typing import Any

import numpy as np
import warp as wp

from laploop.arrays import Float32
from laploop.envs.sensors.kernels import spread_kernels
from laploop.envs.sensors.tracing.view_tracer import ViewTracer
from laploop.perception.geometry import Intrinsics

_END_SIGMAS = 3.5
"""Where the weights of `spread_kernels.diffuse` end, in standard deviations."""
_FARTHEST_M = 0.15
"""Largest usual distance of tissue; beyond it, wide spreads may sample the narrower ones more coarsely than these are wide."""


class SubsurfaceSpread:
    """Spreads irradiance by each object's Gaussians, one on top of the other, along x and then along y.

    Light moves by distance on the surface and not between objects. A wide Gaussian adds to a narrower one, whose result is
    smooth enough for it to skip pixels.

    Attributes:
        result: Device array, irradiance after the spread.
        stages: Recorded launches: each stage needs all of the one before.
    """

    def __init__(self, camera: Intrinsics, tracer: ViewTracer, device: Any, irradiance: Any) -> None:
        self._tracer = tracer
        self._device = device
        self._irradiance = irradiance
        count = camera.height * camera.width
        self._layer, self._distance, self._half, self._scale, self._total, self._sum, *self._turns = (
            wp.zeros(count, dtype=wp.float32, device=device) for _ in range(8)
        )
        self._pixels = spread_kernels.Pixels()
        self._pixels.width, self._pixels.height = camera.width, camera.height
        self._pixels.start = wp.vec2((0.5 - camera.cx) / camera.fx, (0.5 - camera.cy) / camera.fy)
        self._pixels.step = wp.vec2(1.0 / camera.fx, 1.0 / camera.fy)
        self._focal = np.array([camera.fx, camera.fy])
        corner = max(camera.cx, camera.width - camera.cx) / camera.fx, max(camera.cy, camera.height - camera.cy) / camera.fy
        # Seen from the side, neighbours can be nearer to each other than on a facing surface, by the cosine of the ray's angle.
        self._oblique = math.sqrt(1.0 + max(corner) ** 2)
        self.result: Any = irradiance
        self.stages: list[list[list[Any]]] = []
        self._number = 0

    def set_table(self, table: Float32) -> bool:
        """Take a `StripeOptics.subsurface_table`; return whether `result` and `stages` are new."""
        widths = table[..., 1].astype(np.float64)
        narrower = np.concatenate([np.zeros_like(widths[:1]), widths[:-1]])
        added = np.sqrt(np.maximum(widths**2 - narrower**2, 0.0))
        smooth = np.where(added > 0.0, narrower, np.inf).min(axis=1, initial=np.inf)
        strides = np.maximum(1.0, np.minimum(smooth, added.max())[:, None] * self._focal // _FARTHEST_M)
        reaches = _END_SIGMAS * self._oblique * added.max(axis=1)[:, None] * self._focal / strides
        spreads = np.stack([reaches, strides], axis=-1).astype(np.float32)
        gaussians = np.stack([table[..., 0], added], axis=-1).astype(np.float32)
        if len(table) == self._number:
            self._gaussians.assign(gaussians)
            self._spreads.assign(spreads)
            return False
        self._number = len(table)
        self._gaussians: Any = wp.array(gaussians, dtype=wp.vec2, device=self._device)
        self._spreads: Any = wp.array(spreads, dtype=wp.vec2, device=self._device)
        self._record()
        return True

    def _record(self) -> None:
        depth, _, _, _, object_id, _ = self._tracer.outputs
        record = self._tracer.record
        source = self._irradiance
        inputs = [depth, object_id, source]
        self.stages = [[record(spread_kernels.find_layers, inputs, [self._layer, self._distance, self._sum])]]
        for number in range(self._number):
            target = self._turns[number % 2]
            for axis, before, after in ((0, source, self._half), (1, self._half, target)):
                inputs = [number, self._gaussians, self._spreads, axis, self._pixels, object_id, self._layer, self._distance]
                outputs = [self._scale, self._total, after]
                self.stages.append([record(spread_kernels.diffuse, [*inputs, before], outputs)])
            if self._number > 1:
                inputs = [number, self._gaussians, object_id, target]
                self.stages[-1].append(record(spread_kernels.add_spread, inputs, [self._sum]))
            source = target
        self.result = source if self._number == 1 else self._sum
