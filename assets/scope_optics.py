"""Nominal geometry of the structured-light laparoscope's two channels."""

import math
from dataclasses import field
from typing import Annotated

from laploop.assets.stripe_mask import FieldOfView, StripeMask
from laploop.configuration import Field, configuration

Pixels = Annotated[int, Field(ge=16, le=4096, multiple_of=2)]
Baseline = Annotated[float, Field(ge=1e-4, le=0.1)]


@configuration
class ScopeOptics:
    """Camera and projector channel at the distal tip, parallel, the projector to the camera's right (+x).

    The 5 mm channel distance is that of existing 12 mm stereo laparoscopes (Ellis et al., Surg Endosc 2008); 60 degrees is
    the usual field of view of such a scope.
    """

    width: Pixels = 256
    """Columns of the camera's image."""
    height: Pixels = 256
    """Rows of the camera's image."""
    fov_rad: FieldOfView = math.radians(60.0)
    """Full horizontal field of view of the camera."""
    baseline_m: Baseline = 0.005
    """From the camera's centre to the projector's, along the camera's +x."""
    mask: StripeMask = field(default_factory=StripeMask)
