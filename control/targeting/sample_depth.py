"""What a depth frame shows where points appear in it."""

import numpy as np
from numpy.typing import NDArray

from laploop.arrays import Array
from laploop.perception.geometry import Intrinsics
from laploop.perception.messages import DepthFrame


def sample_depth(frame: DepthFrame, camera: Intrinsics, points: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return the depth in metres, (n,), that a frame shows where points (n, 3) appear, and where that is known, (n,).

    Depth is read between the centres of pixels, bilinearly; all four neighbours must be valid.
    """
    pixels = camera.project(points) - 0.5
    last = np.array([camera.width - 1.0, camera.height - 1.0])
    inside = np.asarray(((pixels >= 0.0) & (pixels < last)).all(axis=1))
    # What lies outside of the frame may be read anywhere: it does not count.
    corner = np.where(inside[:, None], np.floor(pixels), 0.0)
    right, down = (pixels - corner).T
    column, row = corner.astype(np.intp).T
    rows, columns = np.stack([row, row + 1, row, row + 1]), np.stack([column, column, column + 1, column + 1])
    depth_m = 1e-3 * frame.estimate.depth_mm[rows, columns].astype(np.float64)
    known = np.isfinite(depth_m) & frame.estimate.valid[rows, columns]
    upper_left, lower_left, upper_right, lower_right = np.where(known, depth_m, 0.0)
    upper = upper_left + right * (upper_right - upper_left)
    lower = lower_left + right * (lower_right - lower_left)
    return upper + down * (lower - upper), inside & known.all(axis=0)
