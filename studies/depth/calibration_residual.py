"""An error of the calibration between scope and reference camera, of a size of one's choice."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from laploop.errors import check_range

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class CalibrationResidual:
    """A rotation and a translation of exactly these sizes, in directions that the seed draws evenly over the sphere.

    They are errors of R and t in `point_in_scope = R point_in_reference + t`: the rotation acts with the lever arm of the
    reference camera's distance, 1 mm for 0.1 degrees at 600 mm.
    """

    mm: float = 0.0
    deg: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a field lies outside its range.
        """
        check_range("residual mm", self.mm, 0.0, 100.0)
        check_range("residual deg", self.deg, 0.0, 30.0)
        check_range("residual seed", self.seed, 0, 2**63)

    @property
    def nothing(self) -> bool:
        """Whether it changes nothing."""
        return self.mm == 0.0 and self.deg == 0.0

    def apply(self, scope_from_reference: Array) -> Array:
        """Return a transform (4x4, metres) with the residual put into it."""
        rng = np.random.default_rng(self.seed)
        axis, direction = (vector / np.linalg.norm(vector) for vector in rng.standard_normal((2, 3)))
        angle = math.radians(self.deg)
        x, y, z = axis
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        turn = np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross
        changed = np.array(scope_from_reference, dtype=np.float64)
        changed[:3, :3] = turn @ changed[:3, :3]
        changed[:3, 3] += 1e-3 * self.mm * direction
        return changed
