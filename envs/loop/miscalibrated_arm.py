"""Nominal kinematics: what the robots compute, with their errors, between the theatre's truth and the controllers."""

import numpy as np

from laploop.arrays import Array
from laploop.control.arm.model import ArmModel
from laploop.envs.loop.kinematic_errors import DrawnErrors
from laploop.envs.theatre.arm import Arm
from laploop.envs.theatre.theatre import Theatre
from laploop.perception.geometry import invert_transform, transform_points


class MiscalibratedArm:
    """One arm as its own kinematics see it; without errors, exactly as it is.

    The trocar is what the arm was taught when it was docked at the start of the episode: the point of its nominal shaft
    that lies as deep as the true trocar on the true one. So errors cause no jump, and show as soon as the arm moves.
    """

    def __init__(self, theatre: Theatre, arm: Arm, errors: DrawnErrors | None) -> None:
        """Take an arm of a theatre at time 0, with its errors if it has any."""
        self._theatre = theatre
        self._arm = arm
        self._errors = errors
        self.model = ArmModel(arm.world_from_base, arm.shaft)
        self.home_q: Array = arm.home_q if errors is None else errors.nominal_joints(arm.home_q)
        self.trocar_in_world: Array = arm.trocar_in_world
        if errors is not None:
            self.trocar_in_world = transform_points(self._nominal_from_true(), arm.trocar_in_world)

    def command(self, q: Array, qdot: Array) -> None:
        """Send the servos targets: nominal joint angles, (6,) rad, and velocities, (6,) rad/s."""
        self._theatre.set_joint_targets(self._arm, q if self._errors is None else self._errors.true_joints(q), qdot)

    def shaft_axis_in_world(self) -> Array:
        """Return the direction of the shaft, (3,), from the trocar to the tip."""
        axis = self._theatre.world_from_shaft(self._arm)[:3, 2]
        return axis if self._errors is None else self._nominal_from_true()[:3, :3] @ axis

    def tip_pose_in_world(self) -> Array:
        """Return the pose of the shaft's frame at its tip, 4x4."""
        pose = self._theatre.world_from_shaft(self._arm)
        return pose if self._errors is None else self._nominal_from_true() @ pose

    def tip_velocity_of_joints(self, q: Array, qdot: Array) -> Array:
        """Return the tip's velocity, (3,) m/s in the world, by joint speeds, (6,) rad/s, once they respect the trocar.

        With x the tip, t the trocar, and J the tip's Jacobian, the shaft's point at the trocar moves by
        `(J_v - skew(t - x) J_w) dq`; its part across the shaft must vanish, and the nearest dq for which it does is the
        orthogonal projection onto the null space of these rows.
        """
        pose = self.model.world_from_shaft(q)
        jacobian = self.model.tip_jacobian(q)
        lever = self.trocar_in_world - pose[:3, 3]
        at_trocar = jacobian[:3] + np.cross(jacobian[3:], lever, axis=0)
        across = pose[:3, :2].T @ at_trocar
        nearest = qdot - np.linalg.pinv(across) @ (across @ qdot)
        return np.asarray(jacobian[:3] @ nearest)

    def shaft_tip_velocity_in_world(self) -> Array:
        """Return the velocity of the shaft's tip, (3,), m/s, from the joints' angles and speeds."""
        jacobian = self.model.tip_jacobian(self._nominal_joints())[:3]
        return np.asarray(jacobian @ self._theatre.joint_velocities(self._arm))

    def _nominal_joints(self) -> Array:
        q = self._theatre.joint_positions(self._arm)
        return q if self._errors is None else self._errors.nominal_joints(q)

    def _nominal_from_true(self) -> Array:
        """Return the motion of the world, 4x4, that takes the true shaft to the nominal one."""
        return self.model.world_from_shaft(self._nominal_joints()) @ invert_transform(self._theatre.world_from_shaft(self._arm))


class MiscalibratedTool(MiscalibratedArm):
    """The tool arm: what its sensors measure of its tip, as `laploop.envs.loop.proprioception` reads it."""

    def __init__(self, theatre: Theatre, errors: DrawnErrors | None) -> None:
        super().__init__(theatre, theatre.tool_arm, errors)

    def tip_in_world(self) -> Array:
        """Return where the kinematics put the tip, (3,)."""
        if self._errors is None:
            return self._theatre.tip_in_world()
        pose = self.model.world_from_shaft(self._nominal_joints())
        return self._errors.nominal_tip(pose[:3, 3], pose)

    def tip_velocity_in_world(self) -> Array:
        """Return the velocity of that tip, (3,), m/s."""
        if self._errors is None:
            return self._theatre.tip_velocity_in_world()
        return self.shaft_tip_velocity_in_world()

    def contact_force_in_world(self) -> Array:
        """Return the force on the tip, (3,), N, which the sensor measures along the tip's own axes."""
        force = self._theatre.contact_force_in_world()
        return force if self._errors is None else self._nominal_from_true()[:3, :3] @ force


class MiscalibratedScope(MiscalibratedArm):
    """The camera arm: where it and the hand-eye calibration put the camera."""

    def __init__(self, theatre: Theatre, errors: DrawnErrors | None) -> None:
        super().__init__(theatre, theatre.camera_arm, errors)

    def world_from_camera(self) -> Array:
        """Return the nominal pose of the camera, 4x4, computer-vision frame."""
        pose = self._theatre.world_from_camera()
        return pose if self._errors is None else self._errors.nominal_camera(self._nominal_from_true() @ pose)
