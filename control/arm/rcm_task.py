"""The trocar and the tip as tasks and limits of Pink.

With `p = R^T (t - x)` the trocar t seen in the shaft's frame (rotation R, origin x, z along the shaft to its tip), the shaft
passes through the trocar when `p_x = p_y = 0`, and `-p_z` of it is inserted. The trocar rests in the world, so with the
shaft's body velocity (v, w) = (J_v, J_w) dq

    dp = -v - w x p = (-J_v + skew(p) J_w) dq,

the first two rows of which are the Jacobian of the remote centre of motion, the third that of the inserted length's negative.
"""

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from pink import Configuration, Task

from laploop.arrays import Array
from laploop.control.arm.model import SHAFT_TIP, checked_vector, read_only
from laploop.control.arm.named_limit import NamedLimit
from laploop.errors import InvalidValueError


def trocar_in_shaft(configuration: Configuration, trocar_in_world: Array) -> Array:
    """Return the trocar point p in the shaft's frame, (3,), metres."""
    return np.asarray(configuration.get_transform_frame_to_world(SHAFT_TIP).actInv(trocar_in_world))


def trocar_jacobian(configuration: Configuration, point_in_shaft: Array) -> Array:
    """Return the derivative (3, nv) of the trocar point in the shaft's frame with respect to the joint angles."""
    jacobian = configuration.get_frame_jacobian(SHAFT_TIP)
    return np.asarray(pin.skew(point_in_shaft) @ jacobian[3:] - jacobian[:3])


class RcmTask(Task):
    """Keep the shaft's axis on the trocar: two rows, metres.

    Meant as one of Pink's `constraints`. Such a constraint holds to first order a step, so what an earlier step left over is
    fed back: `feedback` of it a step, but never more than `max_correction_m`, so that a large error is walked back and not
    jumped over.
    """

    def __init__(self, trocar_in_world: ArrayLike, *, feedback: float = 0.5, max_correction_m: float = 4e-5) -> None:
        """Take the trocar.

        Args:
            trocar_in_world: The point that the axis must meet, (3,).
            feedback: Fraction of the error that one step takes out, above 0 and at most 1.
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
        self.trocar_in_world = read_only(checked_vector("trocar_in_world", trocar_in_world, 3))

    def offset(self, configuration: Configuration) -> Array:
        """Return the lateral offset of the trocar in the shaft's frame, (2,), metres."""
        return trocar_in_shaft(configuration, self.trocar_in_world)[:2]

    def compute_error(self, configuration: Configuration) -> Array:
        """Return the offset, (2,), cut to the length that one step may correct."""
        offset = self.offset(configuration)
        longest = self.max_correction_m / self.gain
        return offset * min(1.0, longest / max(float(np.linalg.norm(offset)), 1e-12))

    def compute_jacobian(self, configuration: Configuration) -> Array:
        """Return the derivative of the offset, (2, nv)."""
        return trocar_jacobian(configuration, trocar_in_shaft(configuration, self.trocar_in_world))[:2]

    def __repr__(self) -> str:
        return f"RcmTask(trocar_in_world={self.trocar_in_world.tolist()}, feedback={self.gain})"


class TipPositionTask(Task):
    """Bring the shaft's tip to a point, along the world's axes: three rows, metres.

    Unlike the translation of Pink's frame task, whose error is the logarithm of a pose, it does not change when the shaft
    rolls.
    """

    def __init__(self, cost_per_m: float) -> None:
        """Take the weight; `target_in_world` starts at the origin."""
        super().__init__(cost=cost_per_m)
        self.target_in_world = np.zeros(3)

    def compute_error(self, configuration: Configuration) -> Array:
        """Return the way from the target to the tip, (3,)."""
        return np.asarray(configuration.get_transform_frame_to_world(SHAFT_TIP).translation - self.target_in_world)

    def compute_jacobian(self, configuration: Configuration) -> Array:
        """Return the derivative of the tip's position, (3, nv)."""
        rotation = configuration.get_transform_frame_to_world(SHAFT_TIP).rotation
        return np.asarray(rotation @ configuration.get_frame_jacobian(SHAFT_TIP)[:3])

    def __repr__(self) -> str:
        return f"TipPositionTask(target_in_world={self.target_in_world.tolist()}, cost={self.cost})"


class InsertionLimit(NamedLimit):
    """Keep the inserted length of the shaft within bounds.

    A step may use at most half of the way that is left, so that the arm comes to rest at the bound. Beyond a bound it only
    forbids going farther: standing still stays allowed, and the problem solvable.
    """

    _GAIN = 0.5

    def __init__(self, trocar_in_world: ArrayLike, *, min_m: float, max_m: float) -> None:
        """Take the trocar, (3,), and the bounds of the distance from it to the tip.

        Raises:
            InvalidValueError: If the trocar is not three finite numbers or the bounds are not in order.
        """
        if not 0.0 <= min_m < max_m:
            raise InvalidValueError("insertion limits in metres", (min_m, max_m), "0 <= min < max")
        self._trocar_in_world = read_only(checked_vector("trocar_in_world", trocar_in_world, 3))
        self._min_m = min_m
        self._max_m = max_m

    def compute_qp_inequalities(self, configuration: Configuration, dt: float) -> tuple[Array, Array]:  # noqa: ARG002 - Pink's signature
        """Return G (2, nv) and h (2,) of `G dq <= h`."""
        point = trocar_in_shaft(configuration, self._trocar_in_world)
        shallower, inserted = trocar_jacobian(configuration, point)[2], -float(point[2])
        left = np.array([self._max_m - inserted, inserted - self._min_m])
        return np.stack([-shallower, shallower]), self._GAIN * np.maximum(left, 0.0)

    def row_names(self, configuration: Configuration, dt: float) -> tuple[str, str]:  # noqa: ARG002 - the base's signature
        """Name the two bounds."""
        return "insertion, longest", "insertion, shortest"
