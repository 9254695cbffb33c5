"""Which pixel of the first frame becomes the target."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.stripe_capture import StripeCapture
from laploop.errors import InvalidValueError, SimulationError
from laploop.perception.geometry import Intrinsics

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class TargetChoiceConfig:
    """What makes a pixel a fair target: seen, lit, in the middle of the view, and not facing away from camera or tool."""

    max_radius_m: float = 0.02
    """Largest distance from the optical axis."""
    max_slope_rad: float = np.deg2rad(40.0)
    """Largest angle between the surface's normal and the viewing ray."""
    max_tool_angle_rad: float = np.deg2rad(65.0)
    """Largest angle between the normal and the direction to the tool's trocar."""
    clearance_m: float = 0.004
    """Room that the tool's shaft needs around its axis, from 10 mm above the target on."""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            InvalidValueError: If a length is not positive or an angle not within 0 to 90 degrees.
        """
        for name in ("max_radius_m", "clearance_m"):
            if getattr(self, name) <= 0.0:
                raise InvalidValueError(name, getattr(self, name), "above 0")
        for name in ("max_slope_rad", "max_tool_angle_rad"):
            if not 0.0 < getattr(self, name) <= np.pi / 2:
                raise InvalidValueError(name, getattr(self, name), "above 0, at most pi / 2")


def choose_target_pixel(
    capture: StripeCapture,
    camera: Intrinsics,
    trocar_in_camera: Array,
    rng: np.random.Generator,
    config: TargetChoiceConfig,
) -> tuple[int, int]:
    """Draw a pixel (column, row) among those that qualify.

    Raises:
        SimulationError: If no pixel qualifies.
    """
    fits = qualifying_pixels(capture, camera, trocar_in_camera, config)
    depth_m = capture.depth_mm.astype(np.float64) * 1e-3
    points = camera.rays * depth_m[..., None]
    rows, columns = np.nonzero(fits)
    surface = points[np.isfinite(depth_m)]
    for k in rng.permutation(len(rows)):
        row, column = int(rows[k]), int(columns[k])
        if shaft_is_clear(points[row, column], trocar_in_camera, surface, config):
            return column, row
    raise SimulationError(
        f"no pixel of the first frame qualifies as a target ({len(rows)} are lit tissue, face camera and tool and lie within "
        f"{config.max_radius_m * 1e3:.0f} mm of the axis); try another seed or a wider TargetChoiceConfig"
    )


def qualifying_pixels(
    capture: StripeCapture, camera: Intrinsics, trocar_in_camera: Array, config: TargetChoiceConfig
) -> NDArray[np.bool_]:
    """Return which pixels, (height, width), are fair targets, but for the room that the shaft needs."""
    depth_m = capture.depth_mm.astype(np.float64) * 1e-3
    points = camera.rays * depth_m[..., None]
    normals = capture.normals.astype(np.float64)
    to_camera = -camera.rays / np.linalg.norm(camera.rays, axis=-1, keepdims=True)
    to_trocar = trocar_in_camera - points
    to_trocar /= np.linalg.norm(to_trocar, axis=-1, keepdims=True)
    return np.asarray(
        (capture.object_id == ObjectId.TISSUE)
        & capture.lit
        & (np.linalg.norm(points[..., :2], axis=-1) < config.max_radius_m)
        & (np.einsum("hwi,hwi->hw", normals, to_camera) > np.cos(config.max_slope_rad))
        & (np.einsum("hwi,hwi->hw", normals, to_trocar) > np.cos(config.max_tool_angle_rad))
    )


def shaft_is_clear(point: Array, trocar_in_camera: Array, surface: Array, config: TargetChoiceConfig) -> bool:
    """Say whether the tool's shaft has room over a point (3,), given points (n, 3) of the surface; the camera's frame."""
    to_trocar = trocar_in_camera - point
    to_trocar /= np.linalg.norm(to_trocar)
    offset = surface - point
    along = offset @ to_trocar
    across = np.linalg.norm(offset - along[:, None] * to_trocar, axis=1)
    return not bool(np.any((along > 0.01) & (across < config.clearance_m)))
