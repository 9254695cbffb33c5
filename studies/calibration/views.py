"""Pictures of a calibration board in front of simulated cameras."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from laploop.assets.calibration_board import BoardSurface, CalibrationBoard
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.tracing.scene_geometry import SceneGeometry
from laploop.errors import InfeasibleError
from laploop.perception.calibration.board_corners import find_corners
from laploop.perception.geometry import Intrinsics, Rig, transform_points

Array = NDArray[np.float64]

_TRIES = 5000
_RETAKES = 20
_STEEPEST_COSINE = 0.6
"""Smallest cosine between the line of sight and the board's normal (53 degrees); beyond it, squares look too narrow."""
_MARGIN_PX = 3.0
_MARGIN_TAN = 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """A pose of the board and its corners in the pictures of one or more cameras."""

    pose: Array
    """4x4, the true pose, in the frame in which it was drawn."""
    corners: tuple[Array, ...]
    """(n, 2) pixels, one array for each camera."""


class _Attachable(Protocol):
    def attach_geometry(self, geometry: SceneGeometry) -> None: ...


class BoardStand:
    """A board or a card in front of cameras."""

    def __init__(self, surface: BoardSurface, cameras: Sequence[_Attachable]) -> None:
        self._points = surface.points
        self._geometry = SceneGeometry(
            points=surface.points,
            triangles=surface.triangles,
            object_ids=int(ObjectId.OTHER),
            albedo_factor=surface.albedo_factor,
        )
        for camera in cameras:
            camera.attach_geometry(self._geometry)

    def place(self, world_from_board: Array) -> None:
        """Move it to a pose, 4x4."""
        self._geometry.move(transform_points(world_from_board, self._points))


def tilted(
    base: Array, middle: Sequence[float] | Array, tilt_deg: Sequence[float] | Array, turn_deg: float, board: CalibrationBoard
) -> Array:
    """Return the pose of a board whose middle is at `middle` (3,), metres.

    Its orientation is `base` (3, 3), tilted about its own x and y by `tilt_deg` and turned about its z by `turn_deg`.
    """
    pose = np.eye(4)
    pose[:3, :3] = base @ Rotation.from_euler("zxy", [turn_deg, *tilt_deg], degrees=True).as_matrix()
    pose[:3, 3] = middle - pose[:3, :3] @ board.centre
    return pose


def draw_pose(
    rng: np.random.Generator,
    board: CalibrationBoard,
    camera: Intrinsics,
    *,
    depths_m: tuple[float, float],
    tilt_deg: float,
    turn_deg: float = 180.0,
    base: Array | None = None,
    seen: Callable[[Array], bool] | None = None,
) -> Array:
    """Draw a pose camera_from_board, 4x4, anywhere in the picture, all squares in view.

    Args:
        rng: Source of the pose.
        board: The board.
        camera: Sees it.
        depths_m: Nearest and farthest of the board's middle.
        tilt_deg: Largest tilt about the board's x and about its y.
        turn_deg: Largest turn in its own plane.
        base: (3, 3), the orientation of the board that is not tilted; facing the camera by default.
        seen: Tells whether everything else sees the board in a pose, or can reach it.

    Raises:
        InfeasibleError: If the board is too large, or too far or near, for the picture.
    """
    base = np.eye(3) if base is None else base
    for _ in range(_TRIES):
        middle = camera.unproject(rng.uniform((0.0, 0.0), (camera.width, camera.height)), rng.uniform(*depths_m))
        tilt, turn = rng.uniform(-tilt_deg, tilt_deg, 2), float(rng.uniform(-turn_deg, turn_deg))
        pose = tilted(base, middle, tilt, turn, board)
        if in_view(pose, board, camera) and (seen is None or seen(pose)):
            return pose
    raise InfeasibleError(
        f"no pose of a board of {board.columns} x {board.rows} squares of {board.square_mm:g} mm at {1e3 * depths_m[0]:.0f} to "
        f"{1e3 * depths_m[1]:.0f} mm was in view after {_TRIES} tries; allowed: a smaller board or other distances"
    )


def depth_slices(depths_m: tuple[float, float], count: int) -> list[tuple[float, float]]:
    """Cut a range of depths into slices, one a view, so that the views spread over all of it."""
    ends = np.linspace(*depths_m, count + 1)
    return list(zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True))


def take_view(
    draw: Callable[[], Array], picture: Callable[[Array], Sequence[NDArray[np.uint8]]], board: CalibrationBoard
) -> View:
    """Draw a pose and take its pictures, until the board is found in all of them.

    Raises:
        InfeasibleError: If it is not found in any of several poses.
    """
    for _ in range(_RETAKES):
        pose = draw()
        corners = [find_corners(image, board) for image in picture(pose)]
        found = [view for view in corners if view is not None]
        if len(found) == len(corners):
            return View(pose=pose, corners=tuple(found))
    raise InfeasibleError(
        f"the board of {board.columns} x {board.rows} squares of {board.square_mm:g} mm was not found in the pictures of "
        f"{_RETAKES} poses; allowed: larger squares, more light or more pixels"
    )


def take_views(
    draw: Callable[[tuple[float, float]], Array],
    picture: Callable[[Array], Sequence[NDArray[np.uint8]]],
    board: CalibrationBoard,
    slices: Sequence[tuple[float, float]],
    done: Callable[[], None],
) -> Iterator[View]:
    """Take a view in each slice of depths; `draw` returns a pose in a slice, `done` is called after each view."""
    for depths in slices:
        yield take_view(partial(draw, depths), picture, board)
        done()


def in_view(camera_from_board: Array, board: CalibrationBoard, camera: Intrinsics) -> bool:
    """Tell whether all squares and half of the border are inside the picture, not seen too much from the side."""
    points = transform_points(camera_from_board, outline(board))
    middle = transform_points(camera_from_board, board.centre)
    if points[:, 2].min() <= 0.0 or camera_from_board[:3, 2] @ middle < _STEEPEST_COSINE * np.linalg.norm(middle):
        return False
    pixels = camera.project(points)
    size = np.array([camera.width, camera.height])
    return bool(((pixels > _MARGIN_PX) & (pixels < size - _MARGIN_PX)).all())


def is_lit(camera_from_board: Array, board: CalibrationBoard, rig: Rig) -> bool:
    """Tell whether all squares of a board lie well inside the projector's field."""
    points = transform_points(rig.projector_from_camera @ camera_from_board, outline(board))
    limit = rig.mask.half_width_tan - _MARGIN_TAN
    return bool((np.abs(points[:, :2]) <= limit * points[:, 2:]).all())


def outline(board: CalibrationBoard) -> Array:
    """Return the corners of the squares' rectangle, half a border wider, (4, 3) in the board's frame."""
    low = -1e-3 * (board.square_mm + 0.5 * board.border_mm)
    x = 1e-3 * ((board.columns - 1) * board.square_mm + 0.5 * board.border_mm)
    y = 1e-3 * ((board.rows - 1) * board.square_mm + 0.5 * board.border_mm)
    return np.array([[low, low, 0.0], [x, low, 0.0], [x, y, 0.0], [low, y, 0.0]])


def between(first_from_second: Array) -> Array:
    """Return the orientation (3, 3), in a first camera's frame, of a board that looks half-way between two cameras."""
    ahead = np.array([0.0, 0.0, 1.0]) + first_from_second[:3, 2]
    ahead /= np.linalg.norm(ahead)
    across = np.cross([0.0, 1.0, 0.0], ahead)
    across /= np.linalg.norm(across)
    return np.column_stack([across, np.cross(ahead, across), ahead])
