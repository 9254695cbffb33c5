"""The optics as arrays on a Warp device, where recorded launches read them."""

import math
from typing import Any

import numpy as np
import warp as wp
from scipy.special import ive

from laploop.arrays import Array
from laploop.envs.sensors.kernels import shading_kernels
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.optics.mask_stack import MaskStack
from laploop.envs.sensors.optics.mask_table import MaskTable
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.perception.geometry import Rig

_NARROWEST_DISK_TAN = 1e-6
_LEAST_WEIGHT = 1e-5
_LENS_WEIGHTS = 64
"""Enough for the widest point spread, of 10 pixels."""


class DeviceOptics:
    """Device arrays of everything in `StripeOptics` that kernels read; `set` changes what they hold.

    Attributes:
        table: The mask's transmission by disk and x; empty where there is a stack.
        stack: The same by disk, y and x; empty where there is a table.
        projection: One `Projection`.
        sensor: One `Sensor`.
        materials: Albedo, reflectance and roughness of each `ObjectId`, one after the other.
        falloff: The lens's transmission relative to its axis, an entry a pixel.
        lens: One half of the lens's point spread along an axis.
        lens_count: How many entries of it count.
    """

    def __init__(self, rig: Rig, columns: int, device: Any, optics: StripeOptics) -> None:
        self._rig = rig
        self._mask: MaskTable | MaskStack
        if rig.mask.varies_along_y:
            self._mask = MaskStack.from_mask(rig.mask)
        else:
            self._mask = MaskTable.from_mask(rig.mask, columns)
        self._blur = optics.projection_blur(rig.camera.fx)
        transmission = self._mask.blurred(self._blur)
        self._transmission: Any = wp.array(transmission, dtype=wp.float32, device=device)
        flat = transmission.ndim == 2
        self.table: Any = self._transmission if flat else wp.zeros((0, 0), dtype=wp.float32, device=device)
        self.stack: Any = wp.zeros((0, 0, 0), dtype=wp.float32, device=device) if flat else self._transmission
        self.projection: Any = wp.zeros(1, dtype=shading_kernels.Projection, device=device)
        self.sensor: Any = wp.zeros(1, dtype=shading_kernels.Sensor, device=device)
        self.materials: Any = wp.zeros(3 * len(ObjectId), dtype=wp.float32, device=device)
        self.falloff: Any = wp.zeros(rig.camera.height * rig.camera.width, dtype=wp.float32, device=device)
        self.lens: Any = wp.zeros(_LENS_WEIGHTS, dtype=wp.float32, device=device)
        self.lens_count: Any = wp.zeros(1, dtype=wp.int32, device=device)
        self._falloff_of: tuple[int, float] = (0, math.nan)

    def set(self, optics: StripeOptics, rays: Array) -> None:
        """Take optics, and the rays (height, width, 3), with z = 1, through their lens."""
        seen = (id(rays), optics.vignetting_exponent)
        if seen != self._falloff_of:
            self.falloff.assign(np.linalg.norm(rays, axis=-1).ravel() ** -optics.vignetting_exponent)
            self._falloff_of = seen
        blur = optics.projection_blur(self._rig.camera.fx)
        if blur != self._blur:
            self._transmission.assign(self._mask.blurred(blur))
            self._blur = blur
        self.materials.assign(optics.material_table.ravel())
        self.projection.assign([self._packed_projection(optics)])
        self.sensor.assign([_packed_sensor(optics)])
        weights = _point_spread(optics.lens_blur_px)
        self.lens.assign(np.pad(weights, (0, _LENS_WEIGHTS - len(weights))))
        self.lens_count.assign(np.array([len(weights)], dtype=np.int32))

    def _packed_projection(self, optics: StripeOptics) -> Any:
        table, blur = self._mask, self._blur
        packed = shading_kernels.Projection()
        packed.intensity_w_sr = optics.axial_intensity_w_sr(self._rig.mask)
        packed.led_exponent = optics.led_exponent
        packed.patterned = 1.0 - optics.glare_fraction
        packed.glare = optics.glare_fraction * table.mean
        packed.sigma = blur.sigma_tan
        packed.radius = 0.5 * blur.aperture_m
        packed.inverse_focus = 1.0 / blur.focus_m
        packed.table_start = table.start
        packed.columns_per_tan = 1.0 / table.step
        packed.levels_per_tan = (len(self._transmission) - 1) / max(blur.largest_radius_tan, _NARROWEST_DISK_TAN)
        packed.cavity = optics.cavity_fraction
        packed.ambient = optics.ambient_w_m2
        return packed


def _packed_sensor(optics: StripeOptics) -> Any:
    packed = shading_kernels.Sensor()
    levels = float(2**optics.bits - 1)
    packed.electrons_per_radiance = optics.electrons_per_radiance
    packed.levels_per_electron = optics.response.gain * levels / optics.full_well_electrons
    packed.read_variance = optics.read_noise_electrons**2
    packed.levels = levels
    packed.inverse_gamma = 1.0 / optics.response.gamma
    return packed


def _point_spread(sigma_px: float) -> Array:
    """Return one half of the lens's point spread along an axis, the middle first; the whole of it adds up to 1.

    It is the discrete Gaussian exp(-s²) I_k(s²) of Lindeberg (1990), which has the Gaussian's variance at any width.
    """
    weights = ive(np.arange(_LENS_WEIGHTS), sigma_px**2)
    weights = weights[weights > _LEAST_WEIGHT]
    half: Array = weights / (weights[0] + 2.0 * weights[1:].sum())
    return half
