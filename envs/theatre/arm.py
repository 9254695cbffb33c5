"""One arm of the theatre: its place, its indices in the model, and the set points of its servos."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from laploop.arrays import Array
from laploop.assets.shafts import Shaft
from laploop.assets.ur5_description import VELOCITY_GAIN_RATIO_S
from laploop.errors import InvalidValueError

Indices = NDArray[np.int32]


@dataclass(frozen=True, kw_only=True, eq=False)
class Arm:
    """An arm with its shaft; indices are into the model's arrays, joints in URDF order."""

    name: str
    """With a slash, the prefix of all its names in the model."""
    shaft: Shaft
    world_from_base: Array
    """4x4, pose of the base link."""
    trocar_in_world: Array
    """(3,), where its shaft passes through the wall."""
    home_q: Array
    """(6,), joint angles at the start of an episode."""
    qpos_indices: Indices
    dof_indices: Indices
    actuator_indices: Indices
    tip_site: int
    """Site with the shaft's frame."""


class JointReference:
    """The servos' set point between two control ticks: the last target, extrapolated by its velocity for one period.

    In the k-th step of length h after the target, the servos get `q + k h q' + (kd / kp) q'`: the position at the end of that
    step plus the velocity feed-forward with which a damped servo follows a ramp without lag. If no new target arrives within
    the period, the joint stops where the extrapolation ended.
    """

    def __init__(self, *, q: Array, timestep_s: float, control_steps: int) -> None:
        """Start at rest at q, (6,)."""
        self._timestep_s = timestep_s
        self._control_steps = control_steps
        self._q = q.copy()
        self._qdot = np.zeros_like(q)
        self._age_steps = 0

    def set_target(self, q: Array, qdot: Array | None) -> None:
        """Set a new target, valid now; without a velocity it is zero.

        Raises:
            InvalidValueError: If q or qdot is not one finite number a joint.
        """
        for name, values in (("q", q), ("qdot", qdot)):
            if values is not None and (np.shape(values) != self._q.shape or not np.all(np.isfinite(values))):
                raise InvalidValueError(name, values, f"{self._q.size} finite numbers")
        self._q = np.array(q, dtype=np.float64)
        self._qdot = np.zeros_like(self._q) if qdot is None else np.array(qdot, dtype=np.float64)
        self._age_steps = 0

    def advance(self) -> Array:
        """Return the servos' inputs (6,) for the coming physics step, and count it."""
        self._age_steps += 1
        elapsed_s = min(self._age_steps, self._control_steps) * self._timestep_s
        ahead_s = VELOCITY_GAIN_RATIO_S if self._age_steps <= self._control_steps else 0.0
        return np.asarray(self._q + (elapsed_s + ahead_s) * self._qdot)
