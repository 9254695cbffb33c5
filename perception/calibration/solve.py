"""A camera from corners in several views, by OpenCV's bundle adjustment."""

from collections.abc import Collection, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from laploop.assets.calibration_board import CalibrationBoard
from laploop.errors import InvalidValueError
from laploop.perception.calibration.results import CameraCalibration, check_view_count
from laploop.perception.geometry import Intrinsics
from laploop.perception.reprojection import BrownDistortion

Array = NDArray[np.float64]

COEFFICIENTS = ("k1", "k2", "p1", "p2")
"""Distortion coefficients that can be estimated; over the field of view of such cameras, k3 is not separable from k2."""

_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 200, 1e-12)
_SIGNIFICANT = 3.0
"""Number of standard deviations from zero at which a coefficient is kept."""
_MIN_TILT_DEG = 15.0
"""Smallest angle between the two views of the board that differ most. Without tilt, distance and focal length are inseparable;
at this angle, with corners accurate to 0.05 px, eight views give the focal length to 1 %."""


def calibrate_camera(
    views: Sequence[Array],
    board: CalibrationBoard,
    *,
    width: int,
    height: int,
    coefficients: Collection[str] | None = None,
) -> CameraCalibration:
    """Estimate intrinsics, distortion and the poses of the board.

    Args:
        views: The board's corners in each picture, (n, 2), as `find_corners` returns them.
        board: The board.
        width: Of the pictures, pixels.
        height: Of the pictures, pixels.
        coefficients: Names of the distortion coefficients to estimate, p1 and p2 together; the others are zero. By default
            those that the views determine: p1 and p2 are dropped if neither is three standard deviations from zero, then k2,
            then k1, since a coefficient that cannot be observed spoils principal point and focal length.

    Raises:
        InvalidValueError: If there are too few views, corners are missing, a coefficient is unknown, or the views do not
            determine the camera.
    """
    check_view_count(len(views))
    pixels = [checked_corners(corners, board).astype(np.float32) for corners in views]
    unknown = sorted(set(coefficients or ()) - set(COEFFICIENTS))
    if unknown or len({"p1", "p2"} & set(coefficients or ())) == 1:
        raise InvalidValueError("coefficients", sorted(coefficients or ()), "k1, k2, and the pair p1 and p2")
    size = (width, height)
    if coefficients is not None:
        return _solve(pixels, board, size, frozenset(coefficients))[0]
    kept = frozenset(COEFFICIENTS)
    for group in (frozenset({"p1", "p2"}), frozenset({"k2"}), frozenset({"k1"})):
        found, deviations = _solve(pixels, board, size, kept)
        if all(abs(getattr(found.distortion, name)) < _SIGNIFICANT * deviations[name] for name in group):
            kept -= group
        elif "k2" in group:
            # k2 implies k1.
            return found
    return _solve(pixels, board, size, kept)[0]


def checked_corners(corners: Array, board: CalibrationBoard) -> Array:
    """Return one view's corners; raises an `InvalidValueError` if they are not the board's, (n, 2), or not finite."""
    count = len(board.corners)
    if corners.shape != (count, 2) or not np.isfinite(corners).all():
        raise InvalidValueError("shape of a view's corners", corners.shape, f"({count}, 2), finite pixels")
    return corners


def _solve(
    pixels: list[NDArray[np.float32]], board: CalibrationBoard, size: tuple[int, int], kept: Collection[str]
) -> tuple[CameraCalibration, dict[str, float]]:
    """Calibrate with the given coefficients free; also return the coefficients' standard deviations."""
    flags = cv2.CALIB_FIX_K3
    for name, flag in (("k1", cv2.CALIB_FIX_K1), ("k2", cv2.CALIB_FIX_K2)):
        flags |= 0 if name in kept else flag
    flags |= 0 if {"p1", "p2"} & set(kept) else cv2.CALIB_ZERO_TANGENT_DIST
    points: Any = [board.corners.astype(np.float32)] * len(pixels)
    guess: Any = np.eye(3)
    threads = cv2.getNumThreads()
    # With several threads, the views are summed in the order in which they finish: other last digits in every run.
    cv2.setNumThreads(1)
    try:
        solution: Any = cv2.calibrateCameraExtended(points, pixels, size, guess, np.zeros(5), flags=flags, criteria=_STOP)
    except cv2.error as error:
        raise InvalidValueError("views", len(pixels), f"views that determine the camera ({error.err})") from error
    finally:
        cv2.setNumThreads(threads)
    matrix, vector, turns, shifts, deviations, _, errors = solution[1:]
    deviation = np.asarray(deviations).ravel()
    poses = np.tile(np.eye(4), (len(pixels), 1, 1))
    for pose, turn, shift in zip(poses, turns, shifts, strict=True):
        pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(turn)[0], shift.ravel()
    normals = poses[:, :3, 2]
    tilt_deg = float(np.degrees(np.arccos(np.clip((normals @ normals.T).min(), -1.0, 1.0))))
    if not (np.isfinite(matrix).all() and tilt_deg >= _MIN_TILT_DEG):
        allowed = f"at least {_MIN_TILT_DEG:g}; tilt the board by 20 degrees and more, to all sides"
        raise InvalidValueError("largest angle in degrees between two views of the board", round(tilt_deg, 1), allowed)
    k1, k2, p1, p2 = (float(value) for value in np.asarray(vector).ravel()[:4])
    found = CameraCalibration(
        intrinsics=Intrinsics(
            width=size[0],
            height=size[1],
            fx=float(matrix[0, 0]),
            fy=float(matrix[1, 1]),
            cx=float(matrix[0, 2]),
            cy=float(matrix[1, 2]),
        ),
        distortion=BrownDistortion(k1=k1, k2=k2, p1=p1, p2=p2),
        view_errors_px=tuple(float(error) for error in np.asarray(errors).ravel()),
        camera_from_board=poses,
    )
    return found, dict(zip(COEFFICIENTS, (float(value) for value in deviation[4:8]), strict=True))
