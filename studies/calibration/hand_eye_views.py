"""Views of a fixed board by the scope on the camera arm, with the arm's joint angles."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from laploop.assets.calibration_board import CalibrationBoard
from laploop.assets.shafts import LAPAROSCOPE
from laploop.control.arm.model import ArmModel
from laploop.control.arm.start_posture import start_posture
from laploop.errors import InfeasibleError
from laploop.perception.geometry import invert_transform
from laploop.studies.calibration.views import BoardStand, depth_slices, draw_pose, is_lit, take_views
from laploop.studies.scenes.optical_bench import OpticalBench

Array = NDArray[np.float64]

_BASE = np.array([-0.55, 0.0, 0.0])
"""As in the theatre."""
_BOARD_IN_WORLD = np.array([0.0, 0.0, 0.1])
_SEED_Q = np.array([-0.20, -1.31, 0.77, -1.03, -1.57, -1.77])
"""Elbow up, the scope straight down above the board."""
_REACH_TRIES = 20
_TILT_DEG = 25.0
_TURN_DEG = 60.0
"""Small enough for the wrist not to wind up."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HandEyeViews:
    """Views of the board, with the arm's pose at each."""

    world_from_flange: tuple[Array, ...]
    """Forward kinematics of the reported joint angles."""
    corners: tuple[Array, ...]
    """(n, 2) pixels."""
    true_flange_from_camera: Array
    """4x4."""


def flange_from_camera(baseline_m: float) -> Array:
    """Return the scope's camera channel on the flange as the laparoscope is built, 4x4."""
    pose = np.eye(4)
    pose[:3, 3] = -0.5 * baseline_m, 0.0, LAPAROSCOPE.length_m
    return pose


def take_hand_eye_views(
    bench: OpticalBench,
    board: CalibrationBoard,
    count: int,
    rng: np.random.Generator,
    *,
    depths_m: tuple[float, float],
    joint_noise_rad: float = 0.0,
    progress: Callable[[], None] = lambda: None,
) -> HandEyeViews:
    """Move the scope to random poses over the board, in even light, and take a picture at each.

    Args:
        bench: Its scope is used; the arm stands as in the theatre.
        board: Lies face up before the arm.
        count: Number of views.
        rng: Source of poses, camera noise and joint noise.
        depths_m: Nearest and farthest of the board's middle.
        joint_noise_rad: Standard deviation of each reported joint angle.
        progress: Called after each view.

    Raises:
        InfeasibleError: If the arm reaches no pose that shows the board, or the board is never found.
    """
    base = np.eye(4)
    base[:3, 3] = _BASE
    arm, camera = ArmModel(base, LAPAROSCOPE), bench.scope_camera(clear_mask=True)
    world_from_board = np.diag([1.0, -1.0, -1.0, 1.0])
    world_from_board[:3, 3] = _BOARD_IN_WORLD - world_from_board[:3, :3] @ board.centre
    BoardStand(board.surface(), [camera]).place(world_from_board)
    camera_on_flange = flange_from_camera(bench.scope.baseline_m)
    shaft_on_flange = np.eye(4)
    shaft_on_flange[2, 3] = LAPAROSCOPE.length_m
    shaft_from_camera = invert_transform(shaft_on_flange) @ camera_on_flange
    lit = partial(is_lit, board=board, rig=camera.rig)

    def draw(depths: tuple[float, float]) -> Array:
        """Return joint angles, (6,)."""
        for _ in range(_REACH_TRIES):
            camera_from_board = draw_pose(
                rng, board, camera.rig.camera, depths_m=depths, tilt_deg=_TILT_DEG, turn_deg=_TURN_DEG, seen=lit
            )
            world_from_camera = world_from_board @ invert_transform(camera_from_board)
            try:
                return start_posture(arm, world_from_camera @ invert_transform(shaft_from_camera), _SEED_Q)
            except InfeasibleError:
                continue
        raise InfeasibleError(f"the arm reaches none of {_REACH_TRIES} poses over the board")

    def picture(q: Array) -> Sequence[NDArray[np.uint8]]:
        return [camera.capture(None, arm.world_from_shaft(q) @ shaft_from_camera, rng).image]

    poses, corners = [], []
    # One view after another, so that the joints' noise is drawn between them.
    for view in take_views(draw, picture, board, depth_slices(depths_m, count), progress):
        reported = view.pose + joint_noise_rad * rng.standard_normal(arm.dof)
        poses.append(arm.world_from_shaft(reported) @ invert_transform(shaft_on_flange))
        corners.append(view.corners[0])
    return HandEyeViews(world_from_flange=tuple(poses), corners=tuple(corners), true_flange_from_camera=camera_on_flange)
