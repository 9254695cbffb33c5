"""Pose of the camera on the arm's flange, from views of a fixed board (AX = XB)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from laploop.assets.calibration_board import CalibrationBoard
from laploop.errors import InvalidValueError
from laploop.perception.calibration.poses import place_board, pose_as_vector, vectors_as_poses
from laploop.perception.calibration.results import CameraCalibration, check_view_count, check_view_errors, root_mean_square
from laploop.perception.geometry import invert_transform, rigid_transform

Array = NDArray[np.float64]

_MIN_TURN_DEG = 10.0
"""About the arm's second axis of rotation: rotations about one axis alone leave the translation along it undetermined."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HandEyeCalibration:
    """Poses of the camera on the flange and of the board in the arm's world."""

    flange_from_camera: Array
    """4x4, metres."""
    world_from_board: Array
    """4x4, metres."""
    view_errors_px: tuple[float, ...]
    """For each view, the root mean square distance between corners and reprojections; joint angles are taken as exact."""

    def __post_init__(self) -> None:
        """Check every field."""
        check_view_errors("view_errors_px", self.view_errors_px)
        for name in ("flange_from_camera", "world_from_board"):
            object.__setattr__(self, name, rigid_transform(name, getattr(self, name)))

    @property
    def error_px(self) -> float:
        """Root mean square over all views, pixels."""
        return root_mean_square(self.view_errors_px)


def calibrate_hand_eye(
    world_from_flange: Sequence[Array], views: Sequence[Array], board: CalibrationBoard, camera: CameraCalibration
) -> HandEyeCalibration:
    """Estimate the camera's pose on the flange.

    Park and Martin's closed form (IEEE Trans Robot Autom 1994) on the poses of single views gives the start; both poses are
    then refined on the corners of all views, with the arm's poses taken as exact.

    Args:
        world_from_flange: The arm's forward kinematics, (4, 4) for each view.
        views: The board's corners, (n, 2) for each view.
        board: The board, which stands still.
        camera: The calibrated camera.

    Raises:
        InvalidValueError: If there are too few views, another number of poses, or the arm did not turn about two axes.
    """
    check_view_count(len(views))
    if len(world_from_flange) != len(views):
        raise InvalidValueError("number of the flange's poses", len(world_from_flange), f"{len(views)}, one a view")
    corners, points = np.array(views), board.corners
    camera_from_board = [place_board(camera, view, points) for view in corners]
    flange_from_camera = solve_ax_xb(world_from_flange, camera_from_board)
    flange_from_world = np.array([invert_transform(pose) for pose in world_from_flange])
    world_from_board = world_from_flange[0] @ flange_from_camera @ camera_from_board[0]

    def misfit(values: Array) -> Array:
        x, board_pose = vectors_as_poses(values.reshape(2, 6))
        placed = invert_transform(x) @ flange_from_world @ board_pose
        in_camera = points @ placed[:, :3, :3].transpose(0, 2, 1) + placed[:, None, :3, 3]
        return corners - camera.project(in_camera)

    start = np.concatenate([pose_as_vector(flange_from_camera), pose_as_vector(world_from_board)])
    # MINPACK does without BLAS, whose last digits depend on its number of threads.
    solution: Any = least_squares(lambda values: misfit(values).ravel(), start, x_scale="jac", jac="3-point", method="lm")
    found = vectors_as_poses(solution.x.reshape(2, 6))
    squares = (misfit(solution.x) ** 2).sum(axis=-1).mean(axis=-1)
    return HandEyeCalibration(
        flange_from_camera=found[0],
        world_from_board=found[1],
        view_errors_px=tuple(float(error) for error in np.sqrt(squares)),
    )


def solve_ax_xb(world_from_flange: Sequence[Array], camera_from_board: Sequence[Array]) -> Array:
    """Return X = flange_from_camera, 4x4, of A X = X B for the motions A and B between all pairs of poses.

    The rotation maps the rotation vectors of the camera's motions to those of the flange's; the translation follows from a
    linear system.

    Raises:
        InvalidValueError: If the arm did not turn about two different axes.
    """
    motions = []
    for i, j in combinations(range(len(world_from_flange)), 2):
        a = invert_transform(world_from_flange[j]) @ world_from_flange[i]
        b = camera_from_board[j] @ invert_transform(camera_from_board[i])
        motions.append((a, b))
    a, b = (np.array(side) for side in zip(*motions, strict=True))
    axes_a, axes_b = (Rotation.from_matrix(side[:, :3, :3]).as_rotvec() for side in (a, b))
    spread_deg = math.degrees(float(np.linalg.svd(axes_a, compute_uv=False)[1]) / math.sqrt(len(axes_a)))
    if spread_deg < _MIN_TURN_DEG:
        allowed = f"at least {_MIN_TURN_DEG:g}; tilt the camera to all sides"
        raise InvalidValueError("turn of the flange about a second axis, in degrees", round(spread_deg, 1), allowed)
    rotation = Rotation.align_vectors(axes_a, axes_b)[0].as_matrix()
    system = (a[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    right = (b[:, :3, 3] @ rotation.T - a[:, :3, 3]).ravel()
    solution = np.eye(4)
    solution[:3, :3] = rotation
    solution[:3, 3] = np.linalg.lstsq(system, right, rcond=None)[0]
    return solution
