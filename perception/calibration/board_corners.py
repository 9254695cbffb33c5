"""Finding the corners of a calibration board in a picture."""

import cv2
import numpy as np
from numpy.typing import NDArray

from laploop.assets.calibration_board import CalibrationBoard
from laploop.errors import InvalidValueError

Array = NDArray[np.float64]

_OPENCV_CENTRE = 0.5
"""OpenCV's first pixel has its centre at 0, ours at 0.5. Corners are shifted here, where they come from OpenCV, and nowhere
else: its solvers take pixels as they are, so that what they return follows our convention."""
_WINDOW_OF_SQUARE = 0.35
"""Half-width, in squares, of the window in which a corner is refined; it contains no other edge."""
_LARGE_PX = 1600
_ATTEMPTS = (
    cv2.CALIB_CB_EXHAUSTIVE,
    cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_NORMALIZE_IMAGE,
)
"""Flags, tried in turn. Histogram equalisation reveals a board in dim light, but amplifies noise in a dark surround: each alone
misses views that the other finds."""
_MIN_OUTER_CONTRAST = 0.3
"""Smallest contrast of each side's outermost squares, as a fraction of the inner ones'; on blank paper it is zero."""


def find_corners(image: NDArray[np.uint8], board: CalibrationBoard) -> Array | None:
    """Find the inner corners of a board to a fraction of a pixel.

    Duda and Frese's detector finds the grid; where its edges cross is then refined on the picture's gradients.

    Args:
        image: (H, W) grey, or (H, W, 3 or 4) with red, green and blue first.
        board: The board; all its squares must be in view.

    Returns:
        (n, 2) pixels in the order of `board.corners`, pixel centres at +0.5; None where the board is not found.

    Raises:
        InvalidValueError: If the array is not such an image.
    """
    grey = _grey(image)
    across, down = board.corner_grid
    coarse = _find_grid(grey, across, down)
    if coarse is None:
        return None
    square_px = min(_shortest(np.diff(coarse, axis=0)), _shortest(np.diff(coarse, axis=1)))
    half = max(2, int(_WINDOW_OF_SQUARE * square_px))
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-4)
    fine = cv2.cornerSubPix(grey, coarse.reshape(-1, 1, 2), (half, half), (-1, -1), stop)
    corners = _in_order(np.asarray(fine, dtype=np.float64).reshape(down, across, 2), grey)
    return corners.reshape(-1, 2) + _OPENCV_CENTRE if _shows_whole_board(corners, grey) else None


def _find_grid(grey: NDArray[np.uint8], across: int, down: int) -> NDArray[np.float32] | None:
    """Find the grid roughly, (down, across, 2) in OpenCV's pixels; large pictures are halved first, for speed."""
    scales = (2, 1) if max(grey.shape) > _LARGE_PX else (1,)
    for scale in scales:
        height, width = (size // scale for size in grey.shape)
        small = grey if scale == 1 else cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA)
        for flags in _ATTEMPTS:
            found, raw = cv2.findChessboardCornersSB(small, (across, down), flags=flags)
            if found:
                place = np.asarray(raw, dtype=np.float32).reshape(down, across, 2)
                return (place + np.float32(_OPENCV_CENTRE)) * np.float32(scale) - np.float32(_OPENCV_CENTRE)
    return None


def _grey(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a picture's grey values, (H, W)."""
    if image.dtype != np.uint8 or not (image.ndim == 2 or (image.ndim == 3 and image.shape[2] in {3, 4})):
        shown = f"{image.dtype} of shape {image.shape}"
        raise InvalidValueError("image", shown, "uint8 of shape (H, W), (H, W, 3) or (H, W, 4)")
    if image.ndim == 2:
        return np.ascontiguousarray(image)
    grey: NDArray[np.uint8] = np.round(image[..., :3].mean(axis=2)).astype(np.uint8)
    return grey


def _shortest(steps: NDArray[np.float32]) -> float:
    return float(np.linalg.norm(steps, axis=-1).min())


def _in_order(corners: Array, grey: NDArray[np.uint8]) -> Array:
    """Put detected corners (down, across, 2) into the board's order: not mirrored, and not turned by 180 degrees."""
    along, downwards = corners[0, -1] - corners[0, 0], corners[-1, 0] - corners[0, 0]
    if along[0] * downwards[1] - along[1] * downwards[0] < 0.0:
        corners = corners[::-1]
    # In the board's order, the first square within the corners is dark.
    return corners if _contrast(_squares(corners, grey)) > 0.0 else corners[::-1, ::-1]


def _shows_whole_board(corners: Array, grey: NDArray[np.uint8]) -> bool:
    """Tell whether squares lie beyond all outer corners (down, across, 2), which are in order.

    With one more corner in one direction than in the other, the detector sometimes turns the board by 90 degrees and takes the
    outline of the squares on the blank border for the missing corners.
    """
    outer = np.pad(corners, ((1, 1), (1, 1), (0, 0)), mode="reflect", reflect_type="odd")
    squares = _squares(outer, grey)
    least = _MIN_OUTER_CONTRAST * _contrast(squares[1:-1, 1:-1])
    last = np.array(squares.shape) - 1
    # Whether the last row and column begin with a dark or a bright square depends on their number.
    sides = ((squares[:1], 0), (squares[-1:], last[0]), (squares[:, :1], 0), (squares[:, -1:], last[1]))
    return all((1 - 2 * (first % 2)) * _contrast(side) > least for side, first in sides)


def _squares(corners: Array, grey: NDArray[np.uint8]) -> Array:
    """Return the grey values in the middles of the squares between corners (down, across, 2)."""
    middles = 0.25 * (corners[:-1, :-1] + corners[1:, :-1] + corners[:-1, 1:] + corners[1:, 1:])
    column, row = np.moveaxis(np.round(middles).astype(np.intp), -1, 0)
    values: Array = grey[np.clip(row, 0, grey.shape[0] - 1), np.clip(column, 0, grey.shape[1] - 1)].astype(np.float64)
    return values


def _contrast(squares: Array) -> float:
    """Return how much brighter the squares with an odd sum of row and column are."""
    even = np.add.outer(np.arange(squares.shape[0]), np.arange(squares.shape[1])) % 2 == 0
    return float(squares[~even].mean() - squares[even].mean())
