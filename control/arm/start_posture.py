"""Joint angles for a wanted pose of the shaft, found once before an episode."""

from collections.abc import Iterator

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from laploop.arrays import Array
from laploop.control.arm.model import SHAFT_TIP, ArmModel, checked_vector
from laploop.errors import InfeasibleError

_MAX_ITERATIONS = 200
_TOLERANCE = 1e-9
_MAX_STEP = 0.5
_SPREAD = (0.3, 0.8, 1.6)
_TRIES_PER_SPREAD = 12


def start_posture(arm: ArmModel, world_from_shaft: ArrayLike, seed_q: ArrayLike) -> Array:
    """Solve the inverse kinematics of the whole pose by damped Gauss-Newton steps.

    From each seed it iterates `q <- q - (J^T J + mu I)^-1 J^T e` with `e` the logarithm of the pose error and `mu` its
    squared norm, which vanishes at the solution and keeps the steps short far from it. The first seed is the caller's; if
    the way from there ends nowhere, others follow, drawn ever farther around it from a generator with a fixed seed, so that
    the same call gives the same posture. Whole turns are taken out towards the caller's seed.

    Args:
        arm: The arm.
        world_from_shaft: Wanted pose of the shaft's tip frame, 4x4.
        seed_q: Joint angles to start from, (6,); the answer keeps to its branch when it can.

    Returns:
        Joint angles, (6,), inside the limits, that reach the pose to 1e-9 m and 1e-9 rad.

    Raises:
        InfeasibleError: If no seed leads to the pose.
        InvalidValueError: If the seed is not six finite numbers.
    """
    seed = checked_vector("seed_q", seed_q, arm.dof)
    target = pin.SE3(np.array(world_from_shaft, dtype=np.float64))
    for start in _starts(seed):
        q = _descend(arm, target, start)
        if q is None:
            continue
        q = _unwound(q, seed, arm)
        if np.all(q >= arm.lower_position) and np.all(q <= arm.upper_position):
            return q
    tried = 1 + len(_SPREAD) * _TRIES_PER_SPREAD
    raise InfeasibleError(
        f"no posture puts the shaft's tip at {np.round(target.translation, 4).tolist()} m along "
        f"{np.round(target.rotation[:, 2], 3).tolist()} from {tried} seeds around {np.round(seed, 3).tolist()} rad; "
        "allowed: poses inside the reach of the arm and its joint limits"
    )


def _starts(seed: Array) -> Iterator[Array]:
    yield seed
    rng = np.random.default_rng(0)
    for spread in _SPREAD:
        for _ in range(_TRIES_PER_SPREAD):
            yield seed + rng.uniform(-spread, spread, seed.size)


def _descend(arm: ArmModel, target: pin.SE3, start: Array) -> Array | None:
    model = arm.model
    data = model.createData()
    frame = model.getFrameId(SHAFT_TIP)
    q = start.copy()
    for _ in range(_MAX_ITERATIONS):
        pin.computeJointJacobians(model, data, q)
        pose = pin.updateFramePlacement(model, data, frame)
        tip_from_target = pose.actInv(target)
        error = pin.log6(tip_from_target).vector
        if max(np.linalg.norm(error[:3]), np.linalg.norm(error[3:])) < 0.1 * _TOLERANCE:
            return q
        jacobian = -pin.Jlog6(tip_from_target.inverse()) @ pin.getFrameJacobian(model, data, frame, pin.LOCAL)
        damping = min(1e-2, float(error @ error)) * 0.1
        step = -np.linalg.solve(jacobian.T @ jacobian + damping * np.eye(model.nv), jacobian.T @ error)
        q = q + step * min(1.0, _MAX_STEP / max(float(np.abs(step).max()), 1e-300))
    return None


def _unwound(q: Array, seed: Array, arm: ArmModel) -> Array:
    turn = 2.0 * np.pi
    nearest = q - turn * np.round((q - seed) / turn)
    # A limit can lie between the seed's turn and the nearest one; a whole turn back is the same posture.
    nearest = np.where(nearest > arm.upper_position, nearest - turn, nearest)
    return np.where(nearest < arm.lower_position, nearest + turn, nearest)
