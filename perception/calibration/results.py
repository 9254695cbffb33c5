"""What a calibration finds: one camera, or a pair."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from laploop.errors import InvalidValueError
from laploop.perception.geometry import Intrinsics
from laploop.perception.reprojection import BrownDistortion

Array = NDArray[np.float64]

MIN_VIEWS = 5
"""Fewer views of a plane leave intrinsics and poses badly told apart."""
_UNDISTORT_STEPS = 30
"""Each leaves a fraction of the error that is the distortion's slope, a quarter at the corners of a strong barrel."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraCalibration:
    """Intrinsics and distortion of one camera, and how well they explain the views of the board."""

    intrinsics: Intrinsics
    """Pixel centres at +0.5; OpenCV's principal point is half a pixel less."""
    distortion: BrownDistortion
    view_errors_px: tuple[float, ...]
    """For each view the root mean square distance between corners and their reprojections."""
    camera_from_board: Array
    """(views, 4, 4), where the board was."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If there are too few views, an error is not a distance, or a pose is not rigid.
        """
        _check_errors(self.view_errors_px)
        poses = np.array(self.camera_from_board, dtype=np.float64)
        if poses.shape != (len(self.view_errors_px), 4, 4):
            raise InvalidValueError("shape of camera_from_board", poses.shape, f"({len(self.view_errors_px)}, 4, 4)")
        for pose in poses:
            check_rigid("camera_from_board", pose)
        poses.flags.writeable = False
        object.__setattr__(self, "camera_from_board", poses)

    @property
    def error_px(self) -> float:
        """Root mean square over all views, pixels."""
        return _root_mean_square(self.view_errors_px)

    def project(self, points_in_camera: Array) -> Array:
        """Project points (..., 3) in metres, with distortion, to pixels (..., 2); z must be positive."""
        z = points_in_camera[..., 2]
        x, y = self.distortion.apply(points_in_camera[..., 0] / z, points_in_camera[..., 1] / z)
        k = self.intrinsics
        return np.stack([k.fx * x + k.cx, k.fy * y + k.cy], axis=-1)

    def undistorted_rays(self) -> Array:
        """Return the rays (height, width, 3), of z = 1, that the lens shows at all pixel centres; by fixed-point iteration."""
        rays: Array = self.intrinsics.rays
        x, y = seen_x, seen_y = rays[..., 0], rays[..., 1]
        for _ in range(_UNDISTORT_STEPS):
            shown_x, shown_y = self.distortion.apply(x, y)
            x, y = x + seen_x - shown_x, y + seen_y - shown_y
        return np.stack([x, y, rays[..., 2]], axis=-1)


@dataclass(frozen=True, kw_only=True, eq=False)
class StereoCalibration:
    """The scope's camera, the reference camera, and where the one is from the other: K_SSLE, K_Zivid and (R, t)."""

    scope: CameraCalibration
    reference: CameraCalibration
    scope_from_reference: Array
    """4x4, metres."""
    view_errors_px: tuple[float, ...]
    """For each pair of views the root mean square error over both pictures, the transform being the same for all."""

    def __post_init__(self) -> None:
        """Check the transform and its errors.

        Raises:
            InvalidValueError: If there are too few views, an error is not a distance, or the transform is not rigid.
        """
        _check_errors(self.view_errors_px)
        transform = np.array(self.scope_from_reference, dtype=np.float64)
        check_rigid("scope_from_reference", transform)
        transform.flags.writeable = False
        object.__setattr__(self, "scope_from_reference", transform)

    @property
    def error_px(self) -> float:
        """Root mean square over all pairs of views, pixels."""
        return _root_mean_square(self.view_errors_px)


def transform_residual(a_from_b: Array, true_a_from_b: Array) -> tuple[float, float]:
    """Return the angle in degrees and the distance in mm by which one rigid transform (4x4, metres) differs from another."""
    turn = a_from_b[:3, :3] @ true_a_from_b[:3, :3].T
    # The sine, for the cosine of a small angle has lost its digits.
    sine = 0.5 * math.hypot(turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1])
    angle = math.atan2(sine, 0.5 * (float(np.trace(turn)) - 1.0))
    return math.degrees(angle), 1e3 * float(np.linalg.norm(a_from_b[:3, 3] - true_a_from_b[:3, 3]))


def check_rigid(name: str, transform: Array) -> None:
    """Raise unless `transform` is a rigid 4x4 transform.

    Raises:
        InvalidValueError: If it is not.
    """
    if transform.shape != (4, 4) or not np.isfinite(transform).all():
        raise InvalidValueError(name, transform.tolist(), "a 4x4 matrix of finite numbers")
    rotation = transform[:3, :3]
    # Files keep all digits; scales and typing errors are far coarser than this.
    orthogonal = (np.abs(rotation @ rotation.T - np.eye(3)) < 1e-6).all() and np.linalg.det(rotation) > 0.0
    if not orthogonal or (transform[3] != [0.0, 0.0, 0.0, 1.0]).any():
        raise InvalidValueError(name, transform.tolist(), "a rigid transform: a rotation and a translation")


def check_view_count(count: int) -> None:
    """Raise unless there are enough views.

    Raises:
        InvalidValueError: If there are fewer than `MIN_VIEWS`.
    """
    if count < MIN_VIEWS:
        raise InvalidValueError("number of views", count, f"at least {MIN_VIEWS}")


def _check_errors(view_errors_px: tuple[float, ...]) -> None:
    check_view_count(len(view_errors_px))
    if not all(math.isfinite(error) and error >= 0.0 for error in view_errors_px):
        raise InvalidValueError("view_errors_px", view_errors_px, "finite numbers from 0 on")


def _root_mean_square(values: tuple[float, ...]) -> float:
    return math.sqrt(sum(value * value for value in values) / len(values))
