"""A moment of a scene."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True, eq=False)
class SceneSnapshot:
    """All of a scene that moves, copied, so that an image of it can be rendered while the simulation goes on."""

    points: NDArray[np.float32]
    """(n, 3), those of the `SceneGeometry`."""
    world_from_camera: NDArray[np.float64]
    """4x4, computer-vision camera."""
