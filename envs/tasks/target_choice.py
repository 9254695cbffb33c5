"""Which pixel of the first frame becomes the target."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from laploop.arrays import Array
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.stripe_capture import ExactView
from laploop.envs.tasks.task_config import TargetChoiceConfig
from laploop.errors import InvalidValueError, SimulationError
from laploop.perception.geometry import Intrinsics


def checked_pixels(name: str, pixels: Any, camera: Intrinsics) -> Array:
    """Return one or more pixels that an option of `reset` names, (n, 2), all within the image.

    Raises:
        InvalidValueError: If they are not pairs of numbers, or lie outside.
    """
    try:
        array = np.atleast_2d(np.asarray(pixels))
    except ValueError:
        array = np.empty(0)
    fits = array.dtype.kind in "fiu" and array.ndim == 2 and array.shape[1] == 2
    if not fits or not ((array >= 0.0) & (array < [camera.width, camera.height])).all():
        raise InvalidValueError(name, pixels, f"(column, row) within {camera.width} x {camera.height} pixels")
    return array.astype(np.float64)


def choose_target_pixel(
    view: ExactView,
    camera: Intrinsics,
    trocar_in_camera: Array,
    rng: np.random.Generator,
    config: TargetChoiceConfig,
) -> tuple[int, int]:
    """Draw a pixel (column, row) among those that qualify.

    Raises:
        SimulationError: If no pixel qualifies.
    """
    fits = qualifying_pixels(view, camera, trocar_in_camera, config)
    depth_m = view.depth_mm.astype(np.float64) * 1e-3
    points = camera.rays * depth_m[..., None]
    rows, columns = np.nonzero(fits)
    surface = points[np.isfinite(depth_m)]
    for k in rng.permutation(len(rows)):
        row, column = int(rows[k]), int(columns[k])
        if shaft_is_clear(points[row, column], trocar_in_camera, surface, config):
            return column, row
    raise SimulationError(
        f"no pixel of the first frame qualifies as a target ({len(rows)} are lit tissue, face camera and tool, lie within "
        f"{config.max_radius_m * 1e3:.0f} mm of the axis and at a depth of {config.min_depth_m * 1e3:.0f} to "
        f"{config.max_depth_m * 1e3:.0f} mm); try another seed or a wider TargetChoiceConfig"
    )


def qualifying_pixels(
    view: ExactView, camera: Intrinsics, trocar_in_camera: Array, config: TargetChoiceConfig
) -> NDArray[np.bool_]:
    """Return which pixels, (height, width), are fair targets, the shaft's clearance aside."""
    depth_m = view.depth_mm.astype(np.float64) * 1e-3
    across_m = camera.axis_tangents * depth_m
    fits = (view.object_id == ObjectId.TISSUE) & view.lit & (across_m < config.max_radius_m)
    fits &= (depth_m >= config.min_depth_m) & (depth_m <= config.max_depth_m)
    rays, normals = camera.rays[fits], view.normals[fits].astype(np.float64)
    to_camera = -rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    to_trocar = trocar_in_camera - rays * depth_m[fits][:, None]
    to_trocar /= np.linalg.norm(to_trocar, axis=-1, keepdims=True)
    faces = (normals * to_camera).sum(axis=-1) > np.cos(config.max_slope_rad)
    fits[fits] = faces & ((normals * to_trocar).sum(axis=-1) > np.cos(config.max_tool_angle_rad))
    return np.asarray(fits)


def shaft_is_clear(point: Array, trocar_in_camera: Array, surface: Array, config: TargetChoiceConfig) -> bool:
    """Return whether the tool's shaft is clear over a point (3,), given points (n, 3) of the surface; the camera's frame."""
    to_trocar = trocar_in_camera - point
    to_trocar /= np.linalg.norm(to_trocar)
    offset = surface - point
    along = offset @ to_trocar
    across_squared = np.einsum("ij,ij->i", offset, offset) - along**2
    return not bool(np.any((along > 0.01) & (across_squared < config.clearance_m**2)))
