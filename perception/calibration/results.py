"""Results of a calibration: one camera, or a pair."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from laploop.errors import InvalidValueError
from laploop.perception.geometry import Intrinsics, rigid_transform
from laploop.perception.reprojection import BrownDistortion

Array = NDArray[np.float64]

MIN_VIEWS = 5
"""Fewer views of a plane hardly separate intrinsics from poses."""
_UNDISTORT_STEPS = 30
"""Each multiplies the error by the slope of the distortion, a quarter at the corners of a strong barrel."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraCalibration:
    """Intrinsics and distortion of one camera, and how well they explain the views of the board."""

    intrinsics: Intrinsics
    """Pixel centres at +0.5; OpenCV's principal point is half a pixel less."""
    distortion: BrownDistortion
    view_errors_px: tuple[float, ...]
    """For each view, the root mean square distance between corners and their reprojections."""
    camera_from_board: Array
    """(views, 4, 4), poses of the board."""

    def __post_init__(self) -> None:
        """Check every field."""
        check_view_errors("view_errors_px", self.view_errors_px)
        poses = np.array([rigid_transform("camera_from_board", pose) for pose in self.camera_from_board])
        if len(poses) != len(self.view_errors_px):
            raise InvalidValueError("number of camera_from_board", len(poses), f"{len(self.view_errors_px)}, one a view")
        poses.flags.writeable = False
        object.__setattr__(self, "camera_from_board", poses)

    @property
    def error_px(self) -> float:
        """Root mean square over all views, pixels."""
        return root_mean_square(self.view_errors_px)

    def project(self, points_in_camera: Array) -> Array:
        """Project points (..., 3) in metres, with distortion, to pixels (..., 2); z must be positive."""
        z = points_in_camera[..., 2]
        x, y = self.distortion.apply(points_in_camera[..., 0] / z, points_in_camera[..., 1] / z)
        k = self.intrinsics
        return np.stack([k.fx * x + k.cx, k.fy * y + k.cy], axis=-1)

    def undistorted_rays(self) -> Array:
        """Return the undistorted rays (height, width, 3), of z = 1, at all pixel centres; by fixed-point iteration."""
        rays: Array = self.intrinsics.rays
        x, y = seen_x, seen_y = rays[..., 0], rays[..., 1]
        for _ in range(_UNDISTORT_STEPS):
            shown_x, shown_y = self.distortion.apply(x, y)
            x, y = x + seen_x - shown_x, y + seen_y - shown_y
        return np.stack([x, y, rays[..., 2]], axis=-1)


@dataclass(frozen=True, kw_only=True, eq=False)
class StereoCalibration:
    """The scope's camera, the reference camera, and the transform between them: K_SSLE, K_Zivid and (R, t)."""

    scope: CameraCalibration
    reference: CameraCalibration
    scope_from_reference: Array
    """4x4, metres."""
    view_errors_px: tuple[float, ...]
    """For each pair of views, the root mean square error over both pictures, with one transform for all."""

    def __post_init__(self) -> None:
        """Check the transform and its errors."""
        check_view_errors("view_errors_px", self.view_errors_px)
        object.__setattr__(self, "scope_from_reference", rigid_transform("scope_from_reference", self.scope_from_reference))

    @property
    def error_px(self) -> float:
        """Root mean square over all pairs of views, pixels."""
        return root_mean_square(self.view_errors_px)


def transform_residual(a_from_b: Array, true_a_from_b: Array) -> tuple[float, float]:
    """Return the angle in degrees and the distance in mm by which one rigid transform (4x4, metres) differs from another."""
    turn = a_from_b[:3, :3] @ true_a_from_b[:3, :3].T
    # By the sine, as the cosine of a small angle has lost its digits.
    sine = 0.5 * math.hypot(turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1])
    angle = math.atan2(sine, 0.5 * (float(np.trace(turn)) - 1.0))
    return math.degrees(angle), 1e3 * float(np.linalg.norm(a_from_b[:3, 3] - true_a_from_b[:3, 3]))


def check_view_count(count: int) -> None:
    """Raise unless there are enough views.

    Raises:
        InvalidValueError: If there are fewer than `MIN_VIEWS`.
    """
    if count < MIN_VIEWS:
        raise InvalidValueError("number of views", count, f"at least {MIN_VIEWS}")


def check_view_errors(name: str, errors: tuple[float, ...]) -> None:
    """Raise unless there are enough views and their errors are distances.

    Raises:
        InvalidValueError: If there are too few, or one is negative or not finite.
    """
    check_view_count(len(errors))
    if not all(math.isfinite(error) and error >= 0.0 for error in errors):
        raise InvalidValueError(name, errors, "finite numbers from 0 on")


def root_mean_square(values: tuple[float, ...]) -> float:
    """Return the root mean square over all views."""
    return math.sqrt(sum(value * value for value in values) / len(values))
