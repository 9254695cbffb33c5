"""The UR5's URDF and meshes: the single source for MuJoCo and Pinocchio."""

from importlib.metadata import distribution
from pathlib import Path

from laploop.errors import MissingFileError

FLANGE = "tool0"
"""Name of the flange body (MuJoCo) and frame (Pinocchio)."""

JOINT_NAMES = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)

VELOCITY_GAIN_RATIO_S = 0.007
"""Damping over stiffness, kd / kp, of every joint's servo: equal on all joints, so that a reference without velocity
feed-forward delays all joints alike and keeps the shaft on its path through the trocar."""


def description_dir() -> Path:
    """Return the folder `ur_description` of the installed example-robot-data.

    Raises:
        MissingFileError: If the package lacks it.
    """
    data = "cmeel.prefix/share/example-robot-data/robots/ur_description"
    root = Path(str(distribution("example-robot-data").locate_file(data)))
    if not root.is_dir():
        raise MissingFileError("UR5 description", root, "reinstall example-robot-data")
    return root


def urdf_path() -> Path:
    """Return the URDF of the UR5."""
    return description_dir() / "urdf" / "ur5_robot.urdf"
