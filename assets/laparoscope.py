"""The structured-light laparoscope that the camera arm holds."""

import math
from typing import Any

import mujoco

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.shafts import LAPAROSCOPE, Shaft
from laploop.assets.ur5 import ARM_COLLISION_BIT, ARM_GROUP

CAMERA = "camera"
PROJECTOR = "projector"
SHAFT_TIP = "shaft_tip"
"""Names of the sites; their frames are the channels' computer-vision frames (z forward, y down) and the shaft's frame."""

HOLDER_LENGTH_M = 0.037
"""The part of the 420 mm shaft beyond the 383 mm from pivot to tip (see `shafts.LAPAROSCOPE`)."""

_DENSITY = 4000.0
"""Half steel, half glass and air by volume, kg/m^3; an estimate, which affects the arm's inertia only."""


def build_laparoscope(*, shaft: Shaft = LAPAROSCOPE, optics: ScopeOptics | None = None) -> Any:
    """Build the laparoscope as a `mujoco.MjSpec` whose world frame is the flange, z along the shaft.

    The camera channel is at x = -b/2 and the projector channel at x = +b/2 of the tip's face, both along the shaft, so that
    the projector is `baseline_m` to the camera's right.

    Args:
        shaft: Length and diameter.
        optics: Channels' distance and field of view; by default the nominal scope's.
    """
    optics = ScopeOptics() if optics is None else optics
    spec = mujoco.MjSpec()
    spec.modelname = "laparoscope"
    body = spec.worldbody.add_body(name="laparoscope", gravcomp=1.0)
    common: dict[str, Any] = {
        "group": ARM_GROUP,
        "contype": ARM_COLLISION_BIT,
        "conaffinity": ARM_COLLISION_BIT,
        "density": _DENSITY,
    }
    add_rod(body, "scope_holder", 0.0, HOLDER_LENGTH_M, 0.02, rgba=[0.25, 0.25, 0.28, 1.0], **common)
    add_rod(body, "scope_shaft", HOLDER_LENGTH_M, shaft.length_m, 0.5 * shaft.diameter_m, rgba=[0.1, 0.1, 0.11, 1.0], **common)
    half = 0.5 * optics.baseline_m
    for name, x in ((SHAFT_TIP, 0.0), (CAMERA, -half), (PROJECTOR, half)):
        body.add_site(name=name, pos=[x, 0.0, shaft.length_m], size=[0.001, 0.001, 0.001], group=4)
    # MuJoCo's camera looks along -z with y up: half a turn about x from the computer-vision frame.
    body.add_camera(
        name=CAMERA,
        pos=[-half, 0.0, shaft.length_m],
        quat=[0.0, 1.0, 0.0, 0.0],
        fovy=_vertical_fov_deg(optics),
        resolution=[optics.width, optics.height],
    )
    return spec


def add_rod(body: Any, name: str, start_m: float, end_m: float, radius_m: float, *, capped: bool = False, **more: Any) -> None:
    """Add a round rod along a body's z axis, a capsule where it is `capped` by hemispheres beyond its ends."""
    kind = mujoco.mjtGeom.mjGEOM_CAPSULE if capped else mujoco.mjtGeom.mjGEOM_CYLINDER
    body.add_geom(name=name, type=kind, fromto=[0.0, 0.0, start_m, 0.0, 0.0, end_m], size=[radius_m, 0.0, 0.0], **more)


def _vertical_fov_deg(optics: ScopeOptics) -> float:
    return math.degrees(2.0 * math.atan(math.tan(0.5 * optics.fov_rad) * optics.height / optics.width))
