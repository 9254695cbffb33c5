"""Tip velocity in, joint reference out, with the shaft held on its trocar."""

import math
from collections.abc import Iterable
from enum import StrEnum
from typing import Any, TypeVar

import numpy as np
import pinocchio as pin
import qpsolvers
from numpy.typing import ArrayLike
from pink import Configuration, FrameTask, PostureTask, Task, build_ik, solve_ik
from pink.barriers import Barrier
from pink.exceptions import NoSolutionFound, NotWithinConfigurationLimits
from pink.limits import Limit

from laploop.arrays import Array
from laploop.assets.shafts import Shaft
from laploop.control.arm.clearance_limits import ShaftClearanceLimit, WallLimit
from laploop.control.arm.joint_limit import JointBoxLimit
from laploop.control.arm.model import SHAFT_TIP, ArmModel, checked_vector
from laploop.control.arm.named_limit import NamedLimit
from laploop.control.arm.rcm_config import RcmControllerConfig
from laploop.control.arm.rcm_task import InsertionLimit, RcmTask, TipPositionTask, trocar_in_shaft
from laploop.errors import InfeasibleError, InvalidValueError

T = TypeVar("T")

_PRIMAL_TOLERANCE = 1e-9
"""Of the solver, in radians and metres a step; its own, 1e-6, is a tenth of a slow step."""

_USED_UP = 1e-8
"""Radians or metres a step below which a limit counts as active."""


class RcmStatus(StrEnum):
    """Outcome of the last step."""

    TRACKING = "tracking"
    """The tip follows the request."""
    LIMITED = "limited"
    """A limit of the joints, of the insertion or of a clearance holds the tip back; `last_reason` names it."""
    HELD = "held"
    """The problem had no solution: the arm brakes, and stands still if even that has none."""


class RcmController:
    """Differential inverse kinematics of one arm under its trocar.

    Each step solves with Pink::

        minimise   |J dq - (x_ref - x)|^2 w_tip + |dq - g (q_0 - q)|^2 w_posture
        subject to the trocar's two rows, the limits of position, speed, acceleration and insertion, and, where they come
                   near, those of the wall and of another shaft,

    and integrates the answer into a reference configuration of its own, so that noise of the measured joints does not
    enter. The sixth degree of freedom, the roll about the shaft, follows the posture that `reset` was given. Without a
    solution the arm brakes and holds.
    """

    def __init__(
        self,
        arm: ArmModel,
        trocar_in_world: ArrayLike,
        config: RcmControllerConfig | None = None,
        *,
        tasks: Iterable[Task] = (),
        limits: Iterable[Limit] = (),
        barriers: Iterable[Barrier] = (),
        constraints: Iterable[Task] = (),
    ) -> None:
        """Set up the problem for an arm and its trocar.

        Args:
            arm: The arm.
            trocar_in_world: (3,).
            config: Limits and weights.
            tasks: Pink's tasks to weigh beside the tip's and the posture's.
            limits: Pink's limits to keep besides the controller's own.
            barriers: Pink's barriers.
            constraints: Pink's tasks to meet exactly besides the trocar's.

        Raises:
            InvalidValueError: If the trocar is not three finite numbers, the insertion limits contradict the shaft, or what
                should be Pink's is not.
        """
        self._arm = arm
        self._config = config = config or RcmControllerConfig()
        self._configuration = _configuration(arm, np.zeros(arm.dof))
        self._trocar_task = RcmTask(trocar_in_world, feedback=config.rcm_feedback)
        self._tip_task = FrameTask(SHAFT_TIP, position_cost=config.tip_cost_per_m, orientation_cost=0.0)
        self._held_back_task = TipPositionTask(config.tip_cost_per_m)
        self._posture_task = PostureTask(cost=config.posture_cost_per_rad, gain=config.posture_gain)
        speed = np.minimum(arm.max_joint_speed, config.max_joint_speed_radps)
        acceleration = np.full(arm.dof, config.max_joint_acceleration_radps2)
        self._joint_limit = JointBoxLimit(arm.lower_position, arm.upper_position, speed, acceleration)
        self._braking_limit = JointBoxLimit(arm.lower_position, arm.upper_position, speed)
        length = arm.shaft.length_m
        self._clearance = ShaftClearanceLimit(
            length_m=length, radius_m=0.5 * arm.shaft.diameter_m, min_clearance_m=config.shaft_clearance_m
        )
        max_insertion = config.max_insertion_m if config.max_insertion_m is not None else length - 0.05
        insertion = InsertionLimit(trocar_in_world, min_m=config.min_insertion_m, max_m=max_insertion)
        self._other_limits: list[Limit] = [insertion, self._clearance]
        if config.wall_outwards != "none":
            wall = WallLimit(
                trocar_in_world,
                config.wall_outwards,
                length_m=length,
                min_tip_depth_m=config.min_tip_depth_m,
                min_flange_height_m=config.min_flange_height_m,
            )
            self._other_limits.append(wall)
        self._other_limits += _all_of(Limit, "limits", limits)
        self._tasks = [self._posture_task, *_all_of(Task, "tasks", tasks)]
        self._barriers = _all_of(Barrier, "barriers", barriers)
        constraints = _all_of(Task, "constraints", constraints)
        self._constraints = [self._trocar_task, *constraints]
        self._qdot = np.zeros(arm.dof)
        self._tip_velocity = np.zeros(3)
        self._tip_reference = np.zeros(3)
        self._started = False
        self._status = RcmStatus.TRACKING
        self._reason = ""

    def __getstate__(self) -> dict[str, Any]:
        """Return what copies and pickles: Pink's configuration is its joint angles, (6,)."""
        return vars(self) | {"_configuration": self.q}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, _configuration=_configuration(state["_arm"], state["_configuration"]))

    @property
    def configuration(self) -> Configuration:
        """Pink's configuration of the reference, for tasks and limits of your own; treat it as read-only."""
        return self._configuration

    @property
    def q(self) -> Array:
        """Reference joint angles at the end of the last step, (6,), read-only."""
        return np.asarray(self._configuration.q)

    @property
    def last_status(self) -> RcmStatus:
        """Outcome of the last step."""
        return self._status

    @property
    def last_reason(self) -> str:
        """What holds the arm back since the last step; empty while the tip follows the request."""
        return self._reason

    @property
    def rcm_error_m(self) -> float:
        """Distance of the trocar from the axis of the reference's shaft."""
        return float(np.linalg.norm(self._trocar_task.offset(self._configuration)))

    @property
    def insertion_m(self) -> float:
        """Length of the reference's shaft between the trocar and the tip."""
        return -float(trocar_in_shaft(self._configuration, self._trocar_task.trocar_in_world)[2])

    @property
    def shaft_clearance_m(self) -> float:
        """Distance between the surfaces of the reference's shaft and the other one; infinite if there is none."""
        return self._clearance.clearance(self._configuration)

    def set_other_shaft(self, world_from_shaft: ArrayLike, shaft: Shaft) -> None:
        """Place another arm's shaft by the pose of its tip frame, 4x4; it counts as standing there from now on.

        Raises:
            InvalidValueError: If the pose has entries that are not finite.
        """
        pose = np.asarray(world_from_shaft, dtype=np.float64)
        self._clearance.set_other(pose[:3, 3], pose[:3, 3] - shaft.length_m * pose[:3, 2], 0.5 * shaft.diameter_m)

    def forget_other_shaft(self) -> None:
        """Stop keeping clear of another shaft."""
        self._clearance.clear_other()

    def reset(self, q: ArrayLike) -> None:
        """Start at rest from joint angles q, (6,), whose shaft passes through the trocar.

        Raises:
            InvalidValueError: If q is not six finite numbers inside the limits.
            InfeasibleError: If the shaft misses the trocar.
        """
        start = checked_vector("joint angles", q, self._arm.dof)
        if np.any(start < self._arm.lower_position) or np.any(start > self._arm.upper_position):
            limits = f"{self._arm.lower_position.tolist()} to {self._arm.upper_position.tolist()} rad"
            raise InvalidValueError("joint angles", start.tolist(), limits)
        miss = float(np.linalg.norm(self._arm.trocar_in_shaft(start, self._trocar_task.trocar_in_world)[:2]))
        if miss > self._config.max_start_error_m:
            raise InfeasibleError(
                f"the shaft misses the trocar by {1e3 * miss:.3f} mm at the start; "
                f"allowed: at most {1e3 * self._config.max_start_error_m:.3f} mm"
            )
        self._configuration.update(start)
        self._posture_task.set_target(start)
        self._stand_still()
        self._started = True
        self._status = RcmStatus.TRACKING
        self._reason = ""

    def step(self, tip_velocity_in_world: ArrayLike, dt: float) -> tuple[Array, Array]:
        """Move the reference for one control period.

        Args:
            tip_velocity_in_world: Wanted velocity of the tip, (3,), m/s; cut to the tip's speed and acceleration.
            dt: Control period in seconds.

        Returns:
            The reference joint angles now, at the start of the period, and the joint velocities to follow throughout it, both
            (6,). Where they lead is `q` from then on, and the next step starts there.

        Raises:
            InvalidValueError: If the velocity is not finite or the period not positive.
            InfeasibleError: If `reset` was never called.
        """
        wanted = checked_vector("tip_velocity_in_world", tip_velocity_in_world, 3)
        if not 0.0 < dt < math.inf:
            raise InvalidValueError("dt", dt, "finite and above 0")
        if not self._started:
            raise InfeasibleError("the controller has no posture to start from; call reset(q) first")
        start, before = self.q.copy(), self._tip_velocity
        if not self._move(self._limited(wanted, before, dt), dt, self._joint_limit):
            # Joint accelerations that contradict the trocar give way to it while the tip brakes.
            if not self._move(self._limited(np.zeros(3), before, dt), dt, self._braking_limit):
                self._stand_still()
            self._status = RcmStatus.HELD
            self._reason = "no step keeps the trocar and all limits at once"
        return start, self._qdot.copy()

    def problem(self, tip_reference_in_world: ArrayLike, dt: float) -> qpsolvers.Problem:
        """Return the quadratic program of a step that brings the tip to a point, (3,), in dt seconds."""
        return build_ik(self._configuration, dt=dt, **self._parts(np.asarray(tip_reference_in_world), dt, self._joint_limit))

    def _parts(self, tip_reference: Array, dt: float, joint_limit: JointBoxLimit) -> dict[str, Any]:
        """Return tasks, limits, barriers and constraints of a step towards a tip position, (3,), by Pink's names."""
        self._joint_limit.set_last_velocity(self._qdot)
        self._trocar_task.max_correction_m = self._config.max_rcm_correction_mps * dt
        if self._status is RcmStatus.LIMITED:
            # A way that limits refuse is long, and a frame task would have the shaft roll to turn that way in the tip's frame.
            self._held_back_task.target_in_world = tip_reference
            tip_task: Task = self._held_back_task
        else:
            rotation = self._configuration.get_transform_frame_to_world(SHAFT_TIP).rotation
            self._tip_task.set_target(pin.SE3(rotation, tip_reference))
            tip_task = self._tip_task
        return {
            "tasks": [tip_task, *self._tasks],
            "limits": [joint_limit, *self._other_limits],
            "barriers": self._barriers,
            "constraints": self._constraints,
        }

    def _move(self, tip_velocity: Array, dt: float, joint_limit: JointBoxLimit) -> bool:
        """Move the reference at a tip velocity, (3,), as far as limits allow; return whether a solution exists."""
        reference = self._tip_reference + dt * tip_velocity
        parts = self._parts(reference, dt, joint_limit)
        try:
            qdot = solve_ik(self._configuration, dt=dt, solver="daqp", primal_tol=_PRIMAL_TOLERANCE, **parts)
        except (NoSolutionFound, NotWithinConfigurationLimits):
            return False
        if not np.isfinite(qdot).all():
            return False
        q = self._configuration.integrate(qdot, dt)
        tip = self._arm.tip_in_world(q)
        ahead = reference - tip
        distance = float(np.linalg.norm(ahead))
        self._status, self._reason = RcmStatus.TRACKING, ""
        if distance > self._config.max_lag_m:
            ahead *= self._config.max_lag_m / distance
            self._status = RcmStatus.LIMITED
            self._reason = self._active_limits([*parts["limits"], *parts["barriers"]], qdot, dt)
        self._configuration.update(q)
        self._qdot = qdot
        self._tip_velocity = tip_velocity
        self._tip_reference = tip + ahead
        return True

    def _active_limits(self, limits: list[Limit | Barrier], qdot: Array, dt: float) -> str:
        """Name the limits and barriers whose rows the step from the present configuration uses up."""
        names: list[str] = []
        for limit in limits:
            inequality = limit.compute_qp_inequalities(self._configuration, dt)
            if inequality is None:
                continue
            rows, bounds = inequality
            used = bounds - rows @ qdot * dt < _USED_UP
            if isinstance(limit, NamedLimit):
                names += [name for name, is_used in zip(limit.row_names(self._configuration, dt), used, strict=True) if is_used]
            elif used.any():
                names.append(type(limit).__name__)
        return ", ".join(dict.fromkeys(names))

    def _stand_still(self) -> None:
        self._qdot = np.zeros(self._arm.dof)
        self._tip_velocity = np.zeros(3)
        self._tip_reference = self._arm.tip_in_world(self.q)

    def _limited(self, wanted: Array, before: Array, dt: float) -> Array:
        """Return the tip velocity nearest to a wanted one, each (3,), that speed and acceleration allow."""
        speed = float(np.linalg.norm(wanted))
        wanted = wanted * min(1.0, self._config.max_tip_speed_mps / max(speed, 1e-12))
        change = wanted - before
        size = float(np.linalg.norm(change))
        return before + change * min(1.0, self._config.max_tip_acceleration_mps2 * dt / max(size, 1e-12))


def _configuration(arm: ArmModel, q: Array) -> Configuration:
    """Return Pink's configuration of an arm at joint angles q, (6,)."""
    # Pink hangs attributes on the model that it is given, so it gets one of its own. The limits it would add by default
    # refer back to the model, a cycle that is never collected.
    model = arm.model.copy()
    model.configuration_limit = model.velocity_limit = None
    return Configuration(model, model.createData(), q, copy_data=False)


def _all_of(kind: type[Any], name: str, given: Iterable[T]) -> list[T]:
    """Return what was given as a list; all must be Pink's tasks, limits or barriers."""
    kept = list(given)
    for one in kept:
        if not isinstance(one, kind):
            raise InvalidValueError(name, one, f"instances of pink's {kind.__name__}")
    return kept
