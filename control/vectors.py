"""Questions to vectors of three numbers, in the few operations that such short ones are worth."""

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def length(vector: Array) -> float:
    """Return the length of a vector, (n,): to the bit what `numpy.linalg.norm` says, in a fraction of its time."""
    return math.sqrt(vector @ vector)


def is_finite(vector: Array) -> bool:
    """Say whether all entries of a short vector, (n,), are finite numbers."""
    return all(map(math.isfinite, vector.tolist()))
