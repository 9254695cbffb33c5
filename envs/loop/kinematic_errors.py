"""Errors of the arms' kinematics and of the hand-eye calibration; off by default, drawn once from a seed."""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from laploop.arrays import Array
from laploop.configuration import Field, configuration
from laploop.perception.calibration.results import CameraCalibration


@dataclass(frozen=True, kw_only=True, eq=False)
class DrawnErrors:
    """One robot's errors: nominal values come from encoders, drawings and calibration, true ones from the simulator."""

    joint_offsets_rad: Array
    """(6,), true minus nominal joint angles."""
    tip_offset_m: Array
    """(3,), true minus nominal tip, in the frame of the shaft."""
    camera_from_nominal: Array
    """4x4, the nominal camera frame seen from the true one."""

    def true_joints(self, nominal: Array) -> Array:
        """Return the true joint angles, (6,), for nominal ones."""
        return np.asarray(nominal + self.joint_offsets_rad)

    def nominal_joints(self, true: Array) -> Array:
        """Return what the encoders read, (6,)."""
        return np.asarray(true - self.joint_offsets_rad)

    def nominal_tip(self, tip: Array, world_from_shaft: Array) -> Array:
        """Return where kinematics with exact joints put the tip, (3,), in the world."""
        return np.asarray(tip - world_from_shaft[:3, :3] @ self.tip_offset_m)

    def nominal_camera(self, world_from_camera: Array) -> Array:
        """Return the nominal pose of the camera, 4x4, in the world."""
        return np.asarray(world_from_camera @ self.camera_from_nominal)


@configuration
class KinematicErrors:
    """Standard deviations of normally distributed errors; zero leaves an error out."""

    joint_rad: Annotated[float, Field(ge=0.0, le=0.1)] = 0.0
    """Of each joint's zero. 0.1 degrees at the wrist move a tip 300-400 mm past the flange by 0.5-0.7 mm."""
    tip_m: Annotated[float, Field(ge=0.0, le=0.02)] = 0.0
    """Of the tip along each axis of the shaft's frame."""
    hand_eye_m: Annotated[float, Field(ge=0.0, le=0.05)] = 0.0
    """Of the camera's position along each axis."""
    hand_eye_rad: Annotated[float, Field(ge=0.0, le=0.2)] = 0.0
    """Of the camera's rotation about each axis."""

    def with_calibration(self, calibration: CameraCalibration, distance_m: float) -> "KinematicErrors":
        """Return the same with a hand-eye error of the size that a calibration's residual allows at a distance.

        A residual of r pixels is an angle r / f, and a shift of that angle times the distance to the board. Averaging over
        many corners makes random errors smaller, but not the systematic ones that a residual also holds: this is the
        cautious end.

        Raises:
            InvalidValueError: If that is beyond what is allowed for an error.
        """
        angle = calibration.error_px / calibration.intrinsics.fx
        return replace(self, hand_eye_rad=angle, hand_eye_m=angle * distance_m)

    def draw(self, rng: np.random.Generator) -> DrawnErrors:
        """Draw one robot; the number of draws does not depend on what is zero."""
        from scipy.spatial.transform import Rotation

        joints, tip, shift, turn = (rng.standard_normal(size) for size in (6, 3, 3, 3))
        camera_from_nominal = np.eye(4)
        camera_from_nominal[:3, :3] = Rotation.from_rotvec(self.hand_eye_rad * turn).as_matrix()
        camera_from_nominal[:3, 3] = self.hand_eye_m * shift
        return DrawnErrors(
            joint_offsets_rad=self.joint_rad * joints, tip_offset_m=self.tip_m * tip, camera_from_nominal=camera_from_nominal
        )
