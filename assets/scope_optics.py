"""Nominal numbers of the structured-light laparoscope's two channels, free of any simulator."""

import math
from dataclasses import dataclass, field

from laploop.assets.stripe_mask import StripeMask
from laploop.errors import InvalidValueError


@dataclass(frozen=True, kw_only=True)
class ScopeOptics:
    """Camera and projector channel at the distal tip, parallel, the projector to the camera's right (+x).

    The 5 mm channel distance is that of existing 12 mm stereo laparoscopes (Ellis et al., Surg Endosc 2008); 60 degrees is
    the usual field of view of such a scope.
    """

    width: int = 256
    height: int = 256
    fov_rad: float = math.radians(60.0)
    """Full horizontal field of view of the camera."""
    baseline_m: float = 0.005
    mask: StripeMask = field(default_factory=StripeMask)

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a field lies outside its range.
        """
        for name in ("width", "height"):
            size = getattr(self, name)
            if size < 16 or size % 2:
                raise InvalidValueError(name, size, "an even number of pixels, at least 16")
        if not 0.0 < self.fov_rad < math.pi:
            raise InvalidValueError("fov_rad", self.fov_rad, "above 0 and below pi")
        if not 0.0 < self.baseline_m < 0.1:
            raise InvalidValueError("baseline_m", self.baseline_m, "above 0 and below 0.1 m")
