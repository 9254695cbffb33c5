"""The table, the abdominal wall with its trocars, and the stage that carries the phantom."""

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from laploop.assets.instrument import VISIBLE_GROUP
from laploop.assets.ur5 import ARM_COLLISION_BIT, ARM_GROUP
from laploop.errors import InvalidValueError

STAGE_PLATE_SIDE_M = 0.28
STAGE_PLATE_THICKNESS_M = 0.008

_RING_SEGMENTS = 16
_DISPLAY = {"group": ARM_GROUP, "contype": 0, "conaffinity": 0}
ABDOMINAL_WALL = "abdominal_wall"
"""Name of the geom that draws the wall."""
_SKIN = [0.87, 0.72, 0.62, 0.35]


def build_operating_table(
    *, wall_height_m: float, trocars: Mapping[str, NDArray[np.float64]], trocar_diameter_m: float = 0.013
) -> Any:
    """Build the table and the abdominal wall as a `mujoco.MjSpec`, table top at z = 0.

    The wall is a flat sheet for display only: it does not collide, the controllers keep the shafts in the trocars. Each trocar
    is a ring and a site of its name in the wall's plane.

    Args:
        wall_height_m: Height of the sheet above the table top.
        trocars: Centre (3,) of each trocar in the world, by name.
        trocar_diameter_m: Inner diameter of the rings: a 12 mm shaft with play.

    Raises:
        InvalidValueError: If a trocar does not lie in the wall.
    """
    spec = mujoco.MjSpec()
    spec.modelname = "operating_table"
    world = spec.worldbody
    world.add_geom(
        name="table_top",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[0.1, 0.0, -0.02],
        size=[1.0, 0.5, 0.02],
        group=ARM_GROUP,
        contype=ARM_COLLISION_BIT,
        conaffinity=ARM_COLLISION_BIT,
        rgba=[0.55, 0.58, 0.6, 1.0],
    )
    world.add_geom(
        name=ABDOMINAL_WALL,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[0.06, 0.0, wall_height_m],
        size=[0.20, 0.18, 0.001],
        rgba=_SKIN,
        **_DISPLAY,
    )
    for name, position in trocars.items():
        if position.shape != (3,) or not math.isclose(float(position[2]), wall_height_m, abs_tol=1e-9):
            raise InvalidValueError(f"trocar {name!r}", position, f"a point (3,) at the wall's height {wall_height_m} m")
        _add_trocar(world, name, position, 0.5 * trocar_diameter_m)
    return spec


def build_stage() -> Any:
    """Build the motorised stage as a `mujoco.MjSpec`: the body `plate`, whose origin is the middle of its upper face.

    Its position is prescribed (a mocap body): the real stage's drive does not yield to what rests on it.
    """
    spec = mujoco.MjSpec()
    spec.modelname = "stage"
    body = spec.worldbody.add_body(name="plate", mocap=True)
    half = 0.5 * STAGE_PLATE_SIDE_M
    body.add_geom(
        name="plate",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[0.0, 0.0, -0.5 * STAGE_PLATE_THICKNESS_M],
        size=[half, half, 0.5 * STAGE_PLATE_THICKNESS_M],
        group=VISIBLE_GROUP,
        # Contacts with the tissue that rests on the plate would fill the contact list.
        contype=0,
        conaffinity=0,
        rgba=[0.35, 0.36, 0.38, 1.0],
    )
    return spec


def _add_trocar(world: Any, name: str, position: NDArray[np.float64], radius: float) -> None:
    world.add_site(name=name, pos=position, size=[0.002, 0.002, 0.002], group=4)
    angles = np.arange(_RING_SEGMENTS + 1) * (2.0 * math.pi / _RING_SEGMENTS)
    ring = position + (radius + 0.002) * np.column_stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)])
    for index, (start, end) in enumerate(pairwise(ring)):
        world.add_geom(
            name=f"{name}_ring_{index}",
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=[*start, *end],
            size=[0.002, 0.0, 0.0],
            rgba=[0.2, 0.45, 0.6, 1.0],
            **_DISPLAY,
        )
