"""The UR5 for MuJoCo, from the URDF that Pinocchio reads, too."""

from pathlib import Path
from typing import Any

import mujoco

from laploop.assets.ur5_description import FLANGE, JOINT_NAMES, VELOCITY_GAIN_RATIO_S, description_dir, urdf_path
from laploop.errors import InvalidValueError

ARM_GROUP = 2
"""Geom group of arms, shafts and furniture, which the endoscope cannot see."""

ARM_COLLISION_BIT = 2
"""Contact type of arms and shafts; the tissue has bit 1, so that arms collide with arms and only the tool's tip with tissue."""

ARMATURE = 0.1
"""Inertia in kg m^2 that rotors and gears add to each joint, from MuJoCo Menagerie's UR5e."""

POSITION_GAINS = (8.0e4, 8.0e4, 4.0e4, 1.2e4, 1.2e4, 1.0e4)
"""Stiffness of each joint's servo in N m/rad, about proportional to the inertia that it moves, so that all joints have
nearly the same bandwidth."""


def build_ur5(*, armature: float = ARMATURE, actuated: bool = True) -> Any:
    """Build one UR5, base link at the origin, flange body `tool0`, as a `mujoco.MjSpec`.

    Inertias, joints and meshes are the URDF's. Gravity is compensated on every body, as by the real controller. Each joint
    gets a position servo `F = kp (u - q) - kd q'`; velocity feed-forward enters through `u = q_ref + kd / kp q'_ref`.

    Args:
        armature: Inertia added to each joint, kg m^2; 0 keeps the mass matrix of the URDF alone.
        actuated: Whether to add the servos.

    Raises:
        InvalidValueError: If the armature is negative.
    """
    if not armature >= 0.0:
        raise InvalidValueError("armature", armature, "0 or more kg m^2")
    spec = mujoco.MjSpec.from_file(str(urdf_path()))
    meshes = description_dir() / "meshes" / "ur5" / "collision"
    for mesh in spec.meshes:
        mesh.file = str(meshes / Path(mesh.file).name)
    spec.modelname = "ur5"
    # Keeps tool0 and base_link as bodies; the URDF reader would weld them into their parents.
    spec.compiler.fusestatic = False
    for body in spec.bodies[1:]:
        body.gravcomp = 1.0
    for geom in spec.geoms:
        geom.group = ARM_GROUP
        geom.contype = ARM_COLLISION_BIT
        geom.conaffinity = ARM_COLLISION_BIT
        geom.rgba = [0.62, 0.68, 0.75, 1.0]
        if geom.type != mujoco.mjtGeom.mjGEOM_MESH:
            # A tiny box at ee_link that the real arm does not have.
            spec.delete(geom)
    for name, gain in zip(JOINT_NAMES, POSITION_GAINS, strict=True):
        spec.joint(name).armature = armature
        if actuated:
            servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            servo.set_to_position(kp=gain, kv=VELOCITY_GAIN_RATIO_S * gain)
    if spec.body(FLANGE) is None:
        raise InvalidValueError("bodies of the UR5", [body.name for body in spec.bodies], f"one of them named {FLANGE}")
    return spec
