"""What a trocar asks of an arm, as Pink knows tasks and limits.

With `p = R^T (t - x)` the trocar t seen in the shaft's frame (rotation R, origin x, z along the shaft to its tip), the shaft
passes through the trocar when `p_x = p_y = 0`, and `-p_z` of it is inserted. The trocar rests in the world, so with the
shaft's body velocity (v, w) = (J_v, J_w) dq

    dp = -v - w x p = (-J_v + skew(p) J_w) dq,

the first two rows of which are the Jacobian of the remote centre of motion, the third that of the inserted length's negative.
"""

import math

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from pink import Configuration, PostureTask, Task
from pink.limits import Limit

from laploop.control.arm.model import SHAFT_TIP, checked_vector, read_only
from laploop.errors import InvalidValueError

Array = NDArray[np.float64]

PoseRows = list[list[float]]
"""A pose, 4x4, as plain numbers: quicker than an array where they are taken one by one."""

_BODY = pin.ReferenceFrame.LOCAL

_DEEPER_AND_BACK = np.array([[-1.0], [1.0]])


class ShaftConfiguration(Configuration):
    """A Pink configuration that takes the pose and the Jacobian of the shaft's tip out of Pinocchio once an update.

    Every task and limit of a step asks for them; what they get is shared and must not be written to.
    """

    def __init__(self, model: pin.Model, data: pin.Data, q: Array) -> None:
        """Start at joint angles q, (nv,)."""
        # By number: Pinocchio looks through all frames for a name.
        self._tip_id = model.getFrameId(SHAFT_TIP)
        super().__init__(model, data, q)

    def update(self, q: Array | None = None) -> None:
        """Run the forward kinematics at joint angles q, (nv,); at the same as before if there are none."""
        if q is not None:
            self.q = read_only(q)
        pin.computeJointJacobians(self.model, self.data, self.q)
        self._tip_pose = pin.updateFramePlacement(self.model, self.data, self._tip_id)
        self._tip_jacobian = pin.getFrameJacobian(self.model, self.data, self._tip_id, _BODY)
        # As one array: the bindings of a pose's parts take as long as the forward kinematics where caches are cold.
        self.world_from_shaft: Array = self._tip_pose.homogeneous
        self.pose_rows: PoseRows = self.world_from_shaft.tolist()

    def get_transform_frame_to_world(self, frame: str) -> pin.SE3:
        """Return the pose of a frame in the world."""
        if frame == SHAFT_TIP:
            return self._tip_pose
        pin.updateFramePlacements(self.model, self.data)
        return super().get_transform_frame_to_world(frame)

    def get_frame_jacobian(self, frame: str) -> Array:
        """Return the Jacobian (6, nv) of a frame's body velocity."""
        return self._tip_jacobian if frame == SHAFT_TIP else np.asarray(super().get_frame_jacobian(frame))


def world_from_shaft(configuration: Configuration) -> Array:
    """Return the pose of the shaft's tip frame, 4x4; it may be shared and must not be written to."""
    if isinstance(configuration, ShaftConfiguration):
        return configuration.world_from_shaft
    return np.asarray(configuration.get_transform_frame_to_world(SHAFT_TIP).homogeneous)


def pose_rows(configuration: Configuration) -> PoseRows:
    """Return the same as `world_from_shaft` as rows of plain numbers."""
    if isinstance(configuration, ShaftConfiguration):
        return configuration.pose_rows
    rows: PoseRows = world_from_shaft(configuration).tolist()
    return rows


def point_in_shaft(configuration: Configuration, point_in_world: Array) -> Array:
    """Return a point (3,) of the world in the shaft's frame, (3,), metres."""
    (a, b, c, left), (d, e, f, back), (g, h, i, down), _ = pose_rows(configuration)
    x, y, z = point_in_world.tolist()
    x, y, z = x - left, y - back, z - down
    return np.array([a * x + d * y + g * z, b * x + e * y + h * z, c * x + f * y + i * z])


def moment(point: Array) -> Array:
    """Return the matrix (3, 3) of the cross product of a point, (3,), with what it is multiplied with."""
    x, y, z = point.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def trocar_in_shaft(configuration: Configuration, trocar_in_world: Array) -> Array:
    """Return the trocar point p in the shaft's frame, (3,), metres."""
    return point_in_shaft(configuration, trocar_in_world)


def trocar_jacobian(configuration: Configuration, point_in_shaft: Array) -> Array:
    """Return the derivative (3, nv) of the trocar point in the shaft's frame with respect to the joint angles."""
    jacobian = configuration.get_frame_jacobian(SHAFT_TIP)
    return np.asarray(moment(point_in_shaft) @ jacobian[3:] - jacobian[:3])


class TrocarView:
    """A trocar as the shaft sees it, worked out once a posture for all that ask."""

    def __init__(self, trocar_in_world: ArrayLike) -> None:
        """Take the trocar, (3,), in the world's frame.

        Raises:
            InvalidValueError: If it is not three finite numbers.
        """
        self.in_world = read_only(checked_vector("trocar_in_world", trocar_in_world, 3))
        self._posture: Array | None = None
        self._seen: tuple[Array, Array]

    def of(self, configuration: Configuration) -> tuple[Array, Array]:
        """Return the trocar in the shaft's frame, (3,), and its derivative by the joint angles, (3, nv)."""
        # Every update of a configuration makes an array of its own.
        if configuration.q is not self._posture:
            point = trocar_in_shaft(configuration, self.in_world)
            self._seen = point, trocar_jacobian(configuration, point)
            self._posture = configuration.q
        return self._seen


class RcmTask(Task):
    """Keep the shaft's axis on the trocar: two rows, metres.

    Meant as a hard constraint. A constraint of Pink holds to first order a step, so what an earlier step left over is fed
    back: `feedback` of it a step, but never more than `max_correction_m`, so that a large error is walked back and not
    jumped over.
    """

    def __init__(self, trocar: ArrayLike | TrocarView, *, feedback: float = 0.5, max_correction_m: float = 4e-5) -> None:
        """Take the trocar.

        Args:
            trocar: The point that the axis must meet, (3,), in the world's frame, or a view of it to share with others.
            feedback: Share of the error that one step takes out, above 0 and at most 1.
            max_correction_m: Longest way that the axis moves in one step to correct itself.

        Raises:
            InvalidValueError: If an argument lies outside its range.
        """
        if not 0.0 < feedback <= 1.0:
            raise InvalidValueError("feedback", feedback, "above 0 and at most 1")
        if not max_correction_m > 0.0:
            raise InvalidValueError("max_correction_m", max_correction_m, "above 0")
        super().__init__(cost=1.0, gain=feedback)
        self.max_correction_m = max_correction_m
        self._trocar = trocar if isinstance(trocar, TrocarView) else TrocarView(trocar)

    def offset(self, configuration: Configuration) -> Array:
        """Return the lateral offset of the trocar in the shaft's frame, (2,), metres."""
        return self._trocar.of(configuration)[0][:2]

    def compute_error(self, configuration: Configuration) -> Array:
        """Return the offset, (2,), cut to the length that one step may work on."""
        offset = self.offset(configuration)
        longest = self.max_correction_m / self.gain
        return offset * min(1.0, longest / max(math.hypot(offset[0], offset[1]), 1e-12))

    def compute_jacobian(self, configuration: Configuration) -> Array:
        """Return the derivative of the offset, (2, nv)."""
        return self._trocar.of(configuration)[1][:2]

    def __repr__(self) -> str:
        """Show the trocar."""
        return f"RcmTask(trocar_in_world={self._trocar.in_world.tolist()}, feedback={self.gain})"


class TipPositionTask(Task):
    """Bring the shaft's tip to a point, along the world's axes: three rows, metres.

    Unlike the translation of a frame task, whose error is the logarithm of a pose, it does not change when the shaft rolls.
    """

    def __init__(self, cost_per_m: float) -> None:
        """Take the weight; `target_in_world` starts at the origin."""
        super().__init__(cost=cost_per_m)
        self._weight = cost_per_m**2
        self.target_in_world = np.zeros(3)

    def compute_error(self, configuration: Configuration) -> Array:
        """Return the way from the target to the tip, (3,)."""
        return world_from_shaft(configuration)[:3, 3] - self.target_in_world

    def compute_jacobian(self, configuration: Configuration) -> Array:
        """Return the derivative of the tip's position, (3, nv)."""
        return np.asarray(world_from_shaft(configuration)[:3, :3] @ configuration.get_frame_jacobian(SHAFT_TIP)[:3])

    def compute_qp_objective(self, configuration: Configuration) -> tuple[Array, Array]:
        """Return what Pink's generic path does, with the one weight of all rows taken out of the products."""
        error, jacobian = self._error_and_jacobian(configuration)
        return self._weight * (jacobian.T @ jacobian), self._weight * (error @ jacobian)

    def _error_and_jacobian(self, configuration: Configuration) -> tuple[Array, Array]:
        return self.compute_error(configuration), self.compute_jacobian(configuration)

    def __repr__(self) -> str:
        """Show the target."""
        return f"TipPositionTask(target_in_world={self.target_in_world.tolist()}, cost={self.cost})"


class TipFrameTask(TipPositionTask):
    """The translation of Pink's frame task towards a pose that is turned as the shaft is, in closed form.

    With the way `d = R^T (x_t - x)` to the target in the shaft's frame, the logarithm of the pose between is (d, 0) and the
    upper rows of its derivative are (1, -skew(d) / 2).
    """

    def compute_error(self, configuration: Configuration) -> Array:
        """Return the way from the tip to the target in the shaft's frame, (3,)."""
        return point_in_shaft(configuration, self.target_in_world)

    def compute_jacobian(self, configuration: Configuration) -> Array:
        """Return its derivative, (3, nv), as a frame task has it."""
        return self._error_and_jacobian(configuration)[1]

    def _error_and_jacobian(self, configuration: Configuration) -> tuple[Array, Array]:
        error, jacobian = self.compute_error(configuration), configuration.get_frame_jacobian(SHAFT_TIP)
        return error, np.asarray(moment(0.5 * error) @ jacobian[3:] - jacobian[:3])


class JointPostureTask(PostureTask):
    """Pink's posture task for joints that simply add up, with a diagonal that is made once."""

    def __init__(self, cost_per_rad: float, gain: float, joints: int) -> None:
        """Take weight, share of the error that a step asks for, and the number of joints."""
        super().__init__(cost=cost_per_rad, gain=gain)
        self._weight = cost_per_rad**2
        self._hessian = read_only(self._weight * np.eye(joints))

    def compute_qp_objective(self, configuration: Configuration) -> tuple[Array, Array]:
        """Return what Pink's generic path does."""
        return self._hessian, (self._weight * self.gain) * (configuration.q - self.target_q)


class InsertionLimit(Limit):
    """Keep the inserted length of the shaft within bounds.

    A step may use at most half of the way that is left, so that the arm comes to rest at the bound. Beyond a bound it only
    forbids going farther: standing still stays allowed, and the problem solvable.
    """

    _GAIN = 0.5

    def __init__(self, trocar: ArrayLike | TrocarView, *, min_m: float, max_m: float) -> None:
        """Take the trocar, (3,), in the world's frame, or a view of it to share, and the bounds of the way from it to the tip.

        Raises:
            InvalidValueError: If the bounds are not in order.
        """
        if not 0.0 <= min_m < max_m:
            raise InvalidValueError("insertion limits in metres", (min_m, max_m), "0 <= min < max")
        self._trocar = trocar if isinstance(trocar, TrocarView) else TrocarView(trocar)
        self._min_m = min_m
        self._max_m = max_m

    def compute_qp_inequalities(self, configuration: Configuration, dt: float) -> tuple[Array, Array]:  # noqa: ARG002 - Pink's signature
        """Return G (2, nv) and h (2,) of `G dq <= h`."""
        point, jacobian = self._trocar.of(configuration)
        shallower, inserted = jacobian[2], -float(point[2])
        left = [max(self._GAIN * way, 0.0) for way in (self._max_m - inserted, inserted - self._min_m)]
        return _DEEPER_AND_BACK * shallower, np.array(left)
