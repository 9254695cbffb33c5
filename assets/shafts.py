"""Dimensions of the shafts that the two arms hold.

A shaft's frame is at its tip, z along the shaft away from the flange; on the arm it is the flange frame `tool0` moved by
`length_m` along z.
"""

from typing import Annotated

from laploop.configuration import Field, configuration


@configuration
class Shaft:
    """A straight cylinder from the arm's flange to its tip."""

    length_m: Annotated[float, Field(ge=0.1, le=1.0)]
    """From the flange to the origin of the shaft's frame."""
    diameter_m: Annotated[float, Field(ge=0.001, le=0.05)]
    """Of the cylinder."""
    tip_radius_m: Annotated[float, Field(ge=0.0, le=0.02)]
    """Radius of the ball end whose centre is the origin of the frame; 0 for a flat face at the origin."""


LAPAROSCOPE = Shaft(length_m=0.420, diameter_m=0.012, tip_radius_m=0.0)
"""12 mm stereo endoscope; 383 mm from pivot to tip at full insertion (da Vinci ECM kinematics), plus its holder."""

INSTRUMENT = Shaft(length_m=0.430, diameter_m=0.005, tip_radius_m=0.0015)
"""5 mm instrument, 400 mm long, plus its holder; a 1.5 mm ball end as in perforation tests (Surg Endosc 2003;17:1923)."""
