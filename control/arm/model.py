"""Rigid-body model of one arm with what it holds, placed in the world."""

import math

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from laploop.arrays import Array
from laploop.assets.shafts import Shaft
from laploop.assets.ur5_description import FLANGE, JOINT_NAMES, urdf_path
from laploop.errors import InvalidValueError

SHAFT_TIP = "shaft_tip"
"""Name of the operational frame at the shaft's tip."""

MAX_JOINT_SPEED = math.pi
"""180 deg/s on every joint (UR5 data sheet)."""

_POSITION_LIMIT = np.array([2.0, 2.0, 1.0, 2.0, 2.0, 2.0]) * math.pi


def read_only(values: ArrayLike) -> Array:
    """Return a copy as float64 that refuses to be written to."""
    copy = np.array(values, dtype=np.float64)
    copy.flags.writeable = False
    return copy


def checked_vector(name: str, values: ArrayLike, length: int) -> Array:
    """Return `values` as a new finite float64 vector of the given length.

    Raises:
        InvalidValueError: If it has another shape or an entry that is not finite.
    """
    vector = np.array(values, dtype=np.float64)
    if vector.shape != (length,) or not np.isfinite(vector).all():
        raise InvalidValueError(name, values, f"{length} finite numbers")
    return vector


class ArmModel:
    """A UR5 that holds a straight shaft, as Pinocchio sees it.

    The model is built from the same URDF as the simulator's; its root is moved by `world_from_base`, so that every frame
    comes out in the world. The operational frame `shaft_tip` is the flange moved by the shaft's length along its z. Joints
    are ordered as in `JOINT_NAMES`, angles in radians.

    Limits are the UR5's: 360 deg on every joint but the elbow, which the arm's own body holds to 180 deg; 180 deg/s.
    """

    def __init__(self, world_from_base: ArrayLike, shaft: Shaft) -> None:
        """Build the model.

        Args:
            world_from_base: Rigid transform, 4x4, of the arm's base link.
            shaft: What the flange holds.

        Raises:
            InvalidValueError: If the transform is not rigid.
        """
        self._world_from_base = _checked_transform("world_from_base", world_from_base)
        self._shaft = shaft
        self._model = _placed_model(self._world_from_base, shaft)
        self._data = self._model.createData()
        self._tip_id = self._model.getFrameId(SHAFT_TIP)
        self._lower = read_only(self._model.lowerPositionLimit)
        self._upper = read_only(self._model.upperPositionLimit)
        self._speed = read_only(self._model.velocityLimit)

    def __reduce__(self) -> tuple[object, ...]:
        """Copy and pickle by what it was made of: Pinocchio's own data does neither."""
        return type(self), (self._world_from_base, self._shaft)

    @property
    def model(self) -> pin.Model:
        """The Pinocchio model; treat it as read-only."""
        return self._model

    @property
    def shaft(self) -> Shaft:
        """What the flange holds."""
        return self._shaft

    @property
    def world_from_base(self) -> Array:
        """Rigid transform of the base link, 4x4, read-only."""
        return self._world_from_base

    @property
    def dof(self) -> int:
        """Number of joints."""
        return int(self._model.nv)

    @property
    def lower_position(self) -> Array:
        """Lower joint limits in radians, (6,), read-only."""
        return self._lower

    @property
    def upper_position(self) -> Array:
        """Upper joint limits in radians, (6,), read-only."""
        return self._upper

    @property
    def max_joint_speed(self) -> Array:
        """Speed limits in rad/s, (6,), read-only."""
        return self._speed

    def world_from_shaft(self, q: ArrayLike) -> Array:
        """Return the pose of the shaft's tip frame at joint angles q, 4x4."""
        pin.framesForwardKinematics(self._model, self._data, self._checked(q))
        return np.array(self._data.oMf[self._tip_id].homogeneous)

    def tip_in_world(self, q: ArrayLike) -> Array:
        """Return the position of the shaft's tip at joint angles q, (3,)."""
        return self.world_from_shaft(q)[:3, 3].copy()

    def tip_jacobian(self, q: ArrayLike) -> Array:
        """Return the Jacobian (6, 6) of the tip's linear (first rows) and angular velocity, both along the world's axes."""
        return np.array(
            pin.computeFrameJacobian(self._model, self._data, self._checked(q), self._tip_id, pin.LOCAL_WORLD_ALIGNED)
        )

    def trocar_in_shaft(self, q: ArrayLike, trocar_in_world: ArrayLike) -> Array:
        """Return the trocar point in the shaft's frame, (3,): x and y are its lateral offset, -z is the inserted length."""
        pose = self.world_from_shaft(q)
        return pose[:3, :3].T @ (np.asarray(trocar_in_world, dtype=np.float64) - pose[:3, 3])

    def _checked(self, q: ArrayLike) -> Array:
        return checked_vector("joint angles", q, self.dof)


def _placed_model(world_from_base: Array, shaft: Shaft) -> pin.Model:
    model = pin.buildModelFromUrdf(str(urdf_path()))
    names = tuple(model.names[1:])
    if names != JOINT_NAMES:
        raise InvalidValueError("joints of the URDF", names, f"{JOINT_NAMES}")
    base = pin.SE3(world_from_base)
    model.jointPlacements[1] = base * model.jointPlacements[1]
    for frame in model.frames:
        if frame.parentJoint == 0 and frame.name != "universe":
            frame.placement = base * frame.placement
    flange = model.frames[model.getFrameId(FLANGE)]
    offset = pin.SE3(np.eye(3), np.array([0.0, 0.0, shaft.length_m]))
    model.addFrame(
        pin.Frame(SHAFT_TIP, flange.parentJoint, model.getFrameId(FLANGE), flange.placement * offset, pin.FrameType.OP_FRAME)
    )
    model.lowerPositionLimit = -_POSITION_LIMIT
    model.upperPositionLimit = _POSITION_LIMIT.copy()
    model.velocityLimit = np.full(model.nv, MAX_JOINT_SPEED)
    return model


def _checked_transform(name: str, transform: ArrayLike) -> Array:
    matrix = read_only(transform)
    rigid = (
        matrix.shape == (4, 4)
        and bool(np.isfinite(matrix).all())
        and np.allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-6)
        and np.linalg.det(matrix[:3, :3]) > 0.0
        and np.array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0])
    )
    if not rigid:
        raise InvalidValueError(name, transform, "a rigid 4x4 transform")
    return matrix
