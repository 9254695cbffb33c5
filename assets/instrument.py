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

TIP_CONTACT = "tip_contact"
"""Name of the geom of ball and neck that touches tissue."""

CONTACT_JOINTS = ("contact_x", "contact_y", "contact_z")
"""Names of the contact body's slide joints; see `build_instrument`."""

IMMOVABLE_KG = 1e4
"""Armature of those joints: a newton changes their speed by 2e-7 m/s in a step."""

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


def build_instrument(*, shaft: Shaft = INSTRUMENT, slides: bool = False) -> Any:
    """Build the instrument as a `mujoco.MjSpec` whose world frame is the flange, z along the shaft.

    From the tip: a ball end of radius `tip_radius_m` on a neck of the same radius, a taper, and the shaft. What may touch the
    tissue is a body of its own, `contact`: ball and neck (`tip_contact`), and the shaft behind the taper. MuJoCo's force sensor
    does not measure contacts with a flex; the theatre sums the contacts of `tip_contact` instead, as if ball, neck and taper
    were distal of a force sensor.

    Args:
        shaft: Dimensions.
        slides: Give the contact body three slide joints, `CONTACT_JOINTS`, along its axes, that no force moves. MuJoCo takes a
            prescribed (mocap) body for one at rest, so that a contact with what such a body carries sees the wrong relative
            velocity; minus the carrier's velocity on these joints, their positions kept at 0, puts that right.
    """
    spec = mujoco.MjSpec()
    spec.modelname = "instrument"
    radius = 0.5 * shaft.diameter_m
    body = spec.worldbody.add_body(name="instrument", gravcomp=1.0)
    arm_contact: dict[str, Any] = {"contype": ARM_COLLISION_BIT, "conaffinity": ARM_COLLISION_BIT, "density": _STEEL}
    # The tissue's flex has the higher priority and sets the contact's parameters.
    contact: dict[str, Any] = {"capped": True, "contype": TISSUE_COLLISION_BIT, "conaffinity": TISSUE_COLLISION_BIT}
    contact |= {"group": COLLISION_GROUP, "mass": 0.0}
    steel = [0.75, 0.76, 0.78, 1.0]
    dark, holder_contact = [0.25, 0.25, 0.28, 1.0], {**arm_contact, "density": 1500.0}
    taper_length = NECK_LENGTH_M + TAPER_LENGTH_M
    taper_start = shaft.length_m - taper_length
    add_rod(body, "holder", 0.0, HOLDER_LENGTH_M, 0.018, group=ARM_GROUP, rgba=dark, **holder_contact)
    add_rod(body, "shaft", HOLDER_LENGTH_M, taper_start, radius, group=VISIBLE_GROUP, rgba=steel, **arm_contact)
    tip = body.add_body(name=TIP, pos=[0.0, 0.0, shaft.length_m], gravcomp=1.0)
    ball: dict[str, Any] = {"group": VISIBLE_GROUP, "density": _STEEL, "rgba": steel, "contype": 0, "conaffinity": 0}
    add_rod(tip, "tip", -NECK_LENGTH_M, 0.0, shaft.tip_radius_m, capped=True, **ball)
    _add_taper(spec, tip, top_radius=radius, end_radius=shaft.tip_radius_m, rgba=steel)
    tip.add_site(name=SHAFT_TIP, size=[0.0005, 0.0005, 0.0005], group=4)
    touching = body.add_body(name="contact", pos=[0.0, 0.0, shaft.length_m])
    if slides:
        # Next to nothing that still counts as a moving body.
        touching.mass, touching.inertia, touching.explicitinertial = 1e-6, [1e-9] * 3, True
        for name, axis in zip(CONTACT_JOINTS, np.eye(3), strict=True):
            touching.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis, armature=IMMOVABLE_KG)
    add_rod(touching, TIP_CONTACT, -NECK_LENGTH_M, 0.0, shaft.tip_radius_m, **contact)
    add_rod(touching, "distal_shaft_contact", -taper_length - _DISTAL_LENGTH_M, -taper_length, radius, **contact)
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
