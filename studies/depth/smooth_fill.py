"""Continuation of a depth map into its unknown parts with the least bending.

Where no light of the projector falls there is nothing to read: depth there can only follow from the surroundings. To estimate
the least cost of that, the exact depth of everything that is lit is continued into the dark.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import spsolve

from laploop.errors import InvalidValueError

_TOUCH = 1e-9
"""Keeps the equations solvable where too few pixels are known to fix a plane."""


def fill_smoothly(depth_mm: NDArray[np.floating], known: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Continue a depth map (H, W), of which some pixels are known, into the others.

    Minimises the sum of the squared Laplacians over the image, with the known pixels as they are: a thin plate, whose borders
    are free along the normal.

    Raises:
        InvalidValueError: If the shapes differ, no pixel is known, or a known one is not finite.
    """
    if depth_mm.shape != known.shape or depth_mm.ndim != 2:
        raise InvalidValueError("shapes of depth and mask", (depth_mm.shape, known.shape), "the same, (H, W)")
    if not known.any() or not np.isfinite(depth_mm[known]).all():
        raise InvalidValueError("known pixels", int(known.sum()), "1 or more, all of them finite")
    filled = np.where(known, depth_mm, 0.0).astype(np.float64).ravel()
    free = ~known.ravel()
    if free.any():
        laplacian = _laplacian(*depth_mm.shape)
        rows = (laplacian.T @ laplacian).tocsr()[free]
        equations = (rows[:, free] + _TOUCH * sparse.eye(int(free.sum()))).tocsc()
        filled[free] = spsolve(equations, -(rows[:, ~free] @ filled[~free]))
    return filled.reshape(depth_mm.shape)


def _laplacian(height: int, width: int) -> sparse.csr_matrix:
    """Return the five-point Laplacian of an image, without differences across its borders."""
    along_y = sparse.kron(_second_difference(height), sparse.eye(width))
    return (along_y + sparse.kron(sparse.eye(height), _second_difference(width))).tocsr()


def _second_difference(size: int) -> sparse.csr_matrix:
    first = sparse.diags([-np.ones(size - 1), np.ones(size - 1)], [0, 1], shape=(size - 1, size))
    return (-first.T @ first).tocsr()
