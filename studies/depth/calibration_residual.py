"""An error of the calibration between scope and reference camera, of a size of one's choice."""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from laploop.configuration import Field, configuration

Array = NDArray[np.float64]


@configuration
class CalibrationResidual:
    """A rotation and a translation of exactly these sizes, in directions that the seed draws evenly over the sphere.

    They are errors of R and t in `point_in_scope = R point_in_reference + t`: the rotation acts with the lever arm of the
    reference camera's distance, 1 mm for 0.1 degrees at 600 mm.
    """

    mm: Annotated[float, Field(ge=0.0, le=100.0)] = 0.0
    deg: Annotated[float, Field(ge=0.0, le=30.0)] = 0.0
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0

    @property
    def nothing(self) -> bool:
        """Whether it changes nothing."""
        return self.mm == 0.0 and self.deg == 0.0

    def apply(self, scope_from_reference: Array) -> Array:
        """Return a transform (4x4, metres) with the residual put into it."""
        rng = np.random.default_rng(self.seed)
        axis, direction = (vector / np.linalg.norm(vector) for vector in rng.standard_normal((2, 3)))
        turn = Rotation.from_rotvec(self.deg * axis, degrees=True).as_matrix()
        changed = np.array(scope_from_reference, dtype=np.float64)
        changed[:3, :3] = turn @ changed[:3, :3]
        changed[:3, 3] += 1e-3 * self.mm * direction
        return changed
