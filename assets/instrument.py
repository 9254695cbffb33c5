"""The blunt probe that the tool arm holds; the force on its tip can be read."""

import math
from typing import Any

import mujoco
import numpy as np

from laploop.assets.laparoscope import SHAFT_TIP, add_rod
from laploop.assets.shafts import INSTRUMENT, Shaft
from laploop.assets.ur5 import ARM_COLLISION_BIT, ARM_GROUP

TIP = "tip"
"""Name of the body distal of the force sensor: ball end, neck and taper."""

TISSUE_COLLISION_BIT = 1
"""Contact type of the tissue and of geoms that can touch it."""

VISIBLE_GROUP = 1
"""Geom group that the endoscope can see."""

COLLISION_GROUP = 3
"""Geom group for contact alone, invisible."""

HOLDER_LENGTH_M = 0.030
"""The part of the 430 mm shaft beyond the 400 mm of the instrument (see `shafts.INSTRUMENT`)."""

NECK_LENGTH_M = 0.010
TAPER_LENGTH_M = 0.014
_DISTAL_LENGTH_M = 0.045
"""Length of the full-width shaft behind the taper that can touch tissue."""

_STEEL = 7850.0
"""kg/m^3."""


def build_instrument(*, shaft: Shaft = INSTRUMENT) -> Any:
    """Build the instrument as a `mujoco.MjSpec` whose world frame is the flange, z along the shaft.

    From the tip: a ball end of radius `tip_radius_m` on a neck of the same radius, a taper, and the shaft. Ball, neck and
    taper are one body, as if distal of a force sensor. MuJoCo's force sensor does not measure contacts with a flex; the
    theatre sums the contacts of this body instead.
    """
    spec = mujoco.MjSpec()
    spec.modelname = "instrument"
    radius = 0.5 * shaft.diameter_m
    body = spec.worldbody.add_body(name="instrument", gravcomp=1.0)
    arm_contact: dict[str, Any] = {"contype": ARM_COLLISION_BIT, "conaffinity": ARM_COLLISION_BIT, "density": _STEEL}
    # The tissue's flex has the higher priority and sets the contact's parameters.
    contact: dict[str, Any] = {"capped": True, "contype": TISSUE_COLLISION_BIT, "conaffinity": TISSUE_COLLISION_BIT}
    steel = [0.75, 0.76, 0.78, 1.0]
    dark, holder_contact = [0.25, 0.25, 0.28, 1.0], {**arm_contact, "density": 1500.0}
    taper_start = shaft.length_m - NECK_LENGTH_M - TAPER_LENGTH_M
    distal_start = taper_start - _DISTAL_LENGTH_M
    add_rod(body, "holder", 0.0, HOLDER_LENGTH_M, 0.018, group=ARM_GROUP, rgba=dark, **holder_contact)
    add_rod(body, "shaft", HOLDER_LENGTH_M, taper_start, radius, group=VISIBLE_GROUP, rgba=steel, **arm_contact)
    add_rod(body, "distal_shaft_contact", distal_start, taper_start, radius, group=COLLISION_GROUP, mass=0.0, **contact)
    tip = body.add_body(name=TIP, pos=[0.0, 0.0, shaft.length_m], gravcomp=1.0)
    ball: dict[str, Any] = {"group": VISIBLE_GROUP, "density": _STEEL, "rgba": steel}
    add_rod(tip, "tip", -NECK_LENGTH_M, 0.0, shaft.tip_radius_m, **ball, **contact)
    _add_taper(spec, tip, top_radius=radius, end_radius=shaft.tip_radius_m, rgba=steel)
    tip.add_site(name=SHAFT_TIP, size=[0.0005, 0.0005, 0.0005], group=4)
    return spec


def _add_taper(spec: Any, tip: Any, *, top_radius: float, end_radius: float, rgba: list[float]) -> None:
    """Join neck and shaft by a visible frustum, in the tip's frame, without contact."""
    sectors = 24
    angle = np.arange(sectors) * (2.0 * math.pi / sectors)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    rings = [
        np.column_stack([radius * circle, np.full(sectors, z)])
        for radius, z in ((top_radius, -NECK_LENGTH_M - TAPER_LENGTH_M), (end_radius, -NECK_LENGTH_M))
    ]
    spec.add_mesh(name="taper", uservert=np.concatenate(rings).ravel())
    tip.add_geom(
        name="taper",
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname="taper",
        group=VISIBLE_GROUP,
        contype=0,
        conaffinity=0,
        density=_STEEL,
        rgba=rgba,
    )
