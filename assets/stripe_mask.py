"""The static binary stripe mask in the projection channel."""

import math
from dataclasses import dataclass

from laploop.errors import InvalidValueError


@dataclass(frozen=True, kw_only=True)
class StripeMask:
    """Alternating opaque and transmissive stripes, parallel to the projector's y axis.

    A position on the mask is given by the tangent coordinate `x / z` of the ray through it, in the projector's frame: dark
    and bright stripes are equidistant in it. `stripes` counts periods (one dark and one bright stripe each) across the
    field of view; 20 is the optimum that Zuo et al. (J Biomed Opt 30(8):086003, 2025) report for this kind of scope.
    """

    stripes: int = 20
    duty: float = 0.5
    phase: float = 0.0
    """Shift of the pattern along x, as a fraction of a period; a bright stripe starts at the left edge when 0."""
    fov_rad: float = math.radians(60.0)

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a field lies outside its range.
        """
        if not 1 <= self.stripes <= 200:
            raise InvalidValueError("stripes", self.stripes, "an integer from 1 to 200")
        if not 0.05 <= self.duty <= 0.95:
            raise InvalidValueError("duty", self.duty, "0.05 to 0.95")
        if not 0.0 < self.fov_rad < math.pi:
            raise InvalidValueError("fov_rad", self.fov_rad, "above 0 and below pi")

    @property
    def half_width_tan(self) -> float:
        """Half the width of the mask in tangent units; nothing is lit beyond it."""
        return math.tan(self.fov_rad / 2.0)

    @property
    def period_tan(self) -> float:
        """Period of the stripes in tangent units."""
        return 2.0 * self.half_width_tan / self.stripes
