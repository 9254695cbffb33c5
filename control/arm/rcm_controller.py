"""Tip velocity in, joint reference out, with the shaft held on its trocar."""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import qpsolvers
from numpy.typing import ArrayLike, NDArray
from pink import Task, build_ik
from pink.limits import Limit

from laploop.assets.shafts import Shaft
from laploop.control.arm.clearance_limits import ShaftClearanceLimit, WallLimit
from laploop.control.arm.joint_limit import JointBoxLimit
from laploop.control.arm.model import ArmModel, checked_vector
from laploop.control.arm.rcm_task import (
    InsertionLimit,
    JointPostureTask,
    RcmTask,
    ShaftConfiguration,
    TipFrameTask,
    TipPositionTask,
    TrocarView,
    trocar_in_shaft,
)
from laploop.control.arm.step_qp import StepQp
from laploop.errors import InfeasibleError, InvalidValueError

Array = NDArray[np.float64]

_AT_REST_RADPS = 1e-4
"""Slower than this, all that goes on is the roll's return to its posture."""

_PRIMAL_TOLERANCE = 1e-9
"""Of the solver, in radians and metres a step; its own, 1e-6, is a tenth of a slow step."""

_MOST_ROWS = 24
"""Of a step: 12 of the joints, 2 each of insertion, wall and trocar, 1 of another shaft, and some to spare."""

_USED_UP = 1e-8
"""Radians or metres a step that are left of a limit that decides."""


class RcmStatus(StrEnum):
    """What became of the last step."""

    TRACKING = "tracking"
    """The tip moved as asked."""
    LIMITED = "limited"
    """A limit of the joints, of the insertion or of a clearance holds the tip back; `last_reason` names it."""
    HELD = "held"
    """The problem had no solution: the arm brakes, and stands still if even that has none."""


@dataclass(frozen=True, kw_only=True)
class RcmControllerConfig:
    """Limits and weights of `RcmController`.

    The tip's speed and acceleration are bounded because a hard constraint holds to first order a step: at 60 mm/s and 125 Hz
    a step of 0.5 mm leaves some micrometres at the trocar, which the next step takes out.
    """

    max_tip_speed_mps: float = 0.06
    max_tip_acceleration_mps2: float = 1.0
    max_joint_speed_radps: float = 1.0
    """Of each joint of the reference, besides the arm's own limit; slows the arm down where a singularity comes near."""
    max_joint_acceleration_radps2: float = 15.0
    """Of each joint of the reference."""
    min_insertion_m: float = 0.02
    max_insertion_m: float | None = None
    """Longest way from the trocar to the tip; None is the shaft's length less 50 mm, to keep the flange off the wall."""
    wall_outwards: tuple[float, float, float] | None = (0.0, 0.0, 1.0)
    """Normal of the wall around the trocar, in the world's frame, out of the patient; None for no wall."""
    min_tip_depth_m: float = 0.01
    """Of the tip below the wall."""
    min_flange_height_m: float = 0.03
    """Of the flange above the wall; what it holds is up to 20 mm thick around the shaft."""
    shaft_margin_m: float = 0.003
    """Room between the surfaces of the own and another shaft, where one is told."""
    rcm_feedback: float = 0.5
    """Share of the trocar's error that one step takes out."""
    max_rcm_correction_mps: float = 0.005
    max_start_error_m: float = 1e-3
    """Largest trocar error of a posture that `reset` accepts."""
    max_lag_m: float = 5e-4
    """How far the reference of the tip may run ahead of a tip that limits hold back."""
    tip_cost_per_m: float = 1e3
    posture_cost_per_rad: float = 1e-2
    """Weight of the pull to the posture of `reset`; far below the tip's, it acts on the roll about the shaft only."""
    posture_gain: float = 0.01
    """Share of the posture's error that one step asks for."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a field lies outside its range.
        """
        positive = (
            "max_tip_speed_mps",
            "max_tip_acceleration_mps2",
            "max_joint_speed_radps",
            "max_joint_acceleration_radps2",
            "max_rcm_correction_mps",
            "max_start_error_m",
            "max_lag_m",
            "tip_cost_per_m",
            "posture_cost_per_rad",
            "min_flange_height_m",
            "shaft_margin_m",
        )
        for name in positive:
            value = getattr(self, name)
            if not 0.0 < value < math.inf:
                raise InvalidValueError(name, value, "finite and above 0")
        for name in ("rcm_feedback", "posture_gain"):
            if not 0.0 < getattr(self, name) <= 1.0:
                raise InvalidValueError(name, getattr(self, name), "above 0 and at most 1")
        for name in ("min_insertion_m", "min_tip_depth_m"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise InvalidValueError(name, getattr(self, name), "0 or more")
        if self.max_insertion_m is not None and not self.min_insertion_m < self.max_insertion_m < math.inf:
            raise InvalidValueError("max_insertion_m", self.max_insertion_m, f"above min_insertion_m ({self.min_insertion_m})")


class RcmController:
    """Differential inverse kinematics of one arm under its trocar.

    Each step solves

        minimise   |J dq - (x_ref - x)|^2 w_tip + |dq - g (q_0 - q)|^2 w_posture
        subject to the trocar's two rows, the limits of position, speed, acceleration and insertion, and, where they come
                   near, those of the wall and of another shaft,

    and integrates the answer into a reference configuration of its own, so that noise of the measured joints does not
    enter. The sixth degree of freedom, the roll about the shaft, follows the posture that `reset` was given. Without a
    solution the arm brakes and holds.
    """

    def __init__(self, arm: ArmModel, trocar_in_world: ArrayLike, config: RcmControllerConfig | None = None) -> None:
        """Set up the problem for an arm and its trocar, (3,), in the world's frame.

        Raises:
            InvalidValueError: If the trocar is not three finite numbers or the insertion limits contradict the shaft.
        """
        self._arm = arm
        self._config = config = config or RcmControllerConfig()
        trocar = TrocarView(trocar_in_world)
        self._trocar_in_world = trocar.in_world
        max_insertion = config.max_insertion_m if config.max_insertion_m is not None else arm.shaft.length_m - 0.05
        # Pink hangs attributes on the model that it is given, so it gets one of its own.
        model = arm.model.copy()
        self._configuration = ShaftConfiguration(model, model.createData(), np.zeros(model.nq))
        self._tip_task = TipFrameTask(config.tip_cost_per_m)
        self._held_back_task = TipPositionTask(config.tip_cost_per_m)
        self._posture_task = JointPostureTask(config.posture_cost_per_rad, config.posture_gain, model.nv)
        speed = np.minimum(arm.max_joint_speed, config.max_joint_speed_radps)
        acceleration = np.full(model.nv, config.max_joint_acceleration_radps2)
        insertion = InsertionLimit(trocar, min_m=config.min_insertion_m, max_m=max_insertion)
        self._joint_limit = JointBoxLimit(arm.lower_position, arm.upper_position, speed, acceleration)
        self._clearance = ShaftClearanceLimit(
            length_m=arm.shaft.length_m, radius_m=0.5 * arm.shaft.diameter_m, margin_m=config.shaft_margin_m
        )
        others: list[Limit] = [insertion, self._clearance]
        if config.wall_outwards is not None:
            wall = WallLimit(
                trocar_in_world,
                config.wall_outwards,
                length_m=arm.shaft.length_m,
                tip_room_m=config.min_tip_depth_m,
                flange_room_m=config.min_flange_height_m,
            )
            others.append(wall)
        self._limits: list[Limit] = [self._joint_limit, *others]
        self._braking_limits: list[Limit] = [
            JointBoxLimit(arm.lower_position, arm.upper_position, speed, max_acceleration=None),
            *others,
        ]
        self._trocar_task = RcmTask(trocar, feedback=config.rcm_feedback)
        self._program = StepQp(model.nv, _MOST_ROWS, _PRIMAL_TOLERANCE)
        self._qdot = np.zeros(model.nv)
        self._tip_velocity = np.zeros(3)
        self._tip_reference = np.zeros(3)
        self._started = False
        self._status = RcmStatus.TRACKING
        self._reason = ""

    @property
    def last_reason(self) -> str:
        """What kept the last step from going as asked; empty while it goes as asked."""
        return self._reason

    @property
    def shaft_room_m(self) -> float:
        """Room between the surfaces of the reference's shaft and the other one; infinite if there is none."""
        return self._clearance.distance(self._configuration)

    def set_other_shaft(self, world_from_shaft: ArrayLike, shaft: Shaft) -> None:
        """Tell where another arm's shaft is, by the pose of its tip frame, 4x4; it counts as standing there from now on.

        Raises:
            InvalidValueError: If the pose has entries that are not finite.
        """
        pose = np.asarray(world_from_shaft, dtype=np.float64)
        self._clearance.set_other(pose[:3, 3], pose[:3, 3] - shaft.length_m * pose[:3, 2], 0.5 * shaft.diameter_m)

    def forget_other_shaft(self) -> None:
        """Keep clear of no other shaft any more."""
        self._clearance.clear_other()

    @property
    def last_status(self) -> RcmStatus:
        """What became of the last step."""
        return self._status

    @property
    def q(self) -> Array:
        """Reference joint angles at the end of the last step, (6,), read-only."""
        return np.asarray(self._configuration.q)

    @property
    def rcm_error_m(self) -> float:
        """Distance of the trocar from the axis of the reference's shaft."""
        return float(np.linalg.norm(trocar_in_shaft(self._configuration, self._trocar_in_world)[:2]))

    @property
    def insertion_m(self) -> float:
        """Length of the reference's shaft between the trocar and the tip."""
        return -float(trocar_in_shaft(self._configuration, self._trocar_in_world)[2])

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
        miss = float(np.linalg.norm(self._arm.trocar_in_shaft(start, self._trocar_in_world)[:2]))
        if miss > self._config.max_start_error_m:
            raise InfeasibleError(
                f"the shaft misses the trocar by {1e3 * miss:.3f} mm at the start; "
                f"allowed: at most {1e3 * self._config.max_start_error_m:.3f} mm"
            )
        self._configuration.update(start)
        self._posture_task.set_target(start)
        self._qdot = np.zeros(self._arm.dof)
        self._tip_velocity = np.zeros(3)
        self._tip_reference = self._tip_in_world()
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
        if not self._move(self._limited(wanted, before, dt), dt, self._limits):
            # Joint accelerations that contradict the trocar give way to it while the tip brakes.
            if not self._move(self._limited(np.zeros(3), before, dt), dt, self._braking_limits):
                self._stand_still()
            self._status = RcmStatus.HELD
            self._reason = "no step keeps the trocar and all limits at once"
        return start, self._qdot.copy()

    def hold(self, dt: float) -> tuple[Array, Array]:
        """Brake, and once at rest stand still without solving anything."""
        if self._started and not self._tip_velocity.any() and float(np.abs(self._qdot).max()) < _AT_REST_RADPS:
            self._qdot = np.zeros(self._arm.dof)
            return self.q.copy(), self._qdot.copy()
        return self.step(np.zeros(3), dt)

    def problem(self, tip_reference_in_world: Array, dt: float, limits: list[Limit] | None = None) -> qpsolvers.Problem:
        """Return the quadratic program of a step towards a tip position, (3,), in the world's frame, as Pink builds it.

        Args:
            tip_reference_in_world: Where the tip should be after the step.
            dt: Control period in seconds.
            limits: Inequalities to keep; all of the controller's when left out.
        """
        tasks = self._tasks_towards(tip_reference_in_world, dt)
        return build_ik(
            self._configuration,
            tasks,
            dt,
            limits=self._limits if limits is None else limits,
            constraints=[self._trocar_task],
        )

    def _tasks_towards(self, tip_reference: Array, dt: float) -> list[Task]:
        """Set all parts of the problem for a step, and return the tasks that it weighs."""
        self._joint_limit.set_last_velocity(self._qdot)
        self._trocar_task.max_correction_m = self._config.max_rcm_correction_mps * dt
        # A way that limits refuse is long, and a frame task would have the shaft roll to turn that way in the tip's frame.
        tip_task = self._held_back_task if self._status is RcmStatus.LIMITED else self._tip_task
        tip_task.target_in_world = tip_reference
        return [tip_task, self._posture_task]

    def _move(self, tip_velocity: Array, dt: float, limits: list[Limit]) -> bool:
        reference = self._tip_reference + dt * tip_velocity
        tasks = self._tasks_towards(reference, dt)
        self._program.assemble(self._configuration, tasks, limits, self._trocar_task, dt)
        step = self._program.solve()
        if step is None:
            return False
        self._configuration.update(self._configuration.q + step)
        self._qdot = step / dt
        self._tip_velocity = tip_velocity
        self._status = RcmStatus.TRACKING
        self._reason = ""
        tip = self._tip_in_world()
        ahead = reference - tip
        distance = math.sqrt(ahead @ ahead)
        if distance > self._config.max_lag_m:
            ahead *= self._config.max_lag_m / distance
            self._status = RcmStatus.LIMITED
            self._reason = self._active_limits(step)
        self._tip_reference = tip + ahead
        return True

    def _active_limits(self, step: Array) -> str:
        """Name the limits whose rows a step has used up."""
        used = self._program.room(step) < _USED_UP
        names = [*self._joint_limit.reasons(), "insertion, longest", "insertion, shortest"]
        for limit in self._limits[2:]:
            names += getattr(limit, "reasons", ())
        return ", ".join(dict.fromkeys(name for name, row_is_used in zip(names, used, strict=True) if row_is_used))

    def _stand_still(self) -> None:
        self._qdot = np.zeros(self._arm.dof)
        self._tip_velocity = np.zeros(3)
        self._tip_reference = self._tip_in_world()

    def _limited(self, wanted: Array, before: Array, dt: float) -> Array:
        speed = math.sqrt(wanted @ wanted)
        wanted = wanted * min(1.0, self._config.max_tip_speed_mps / max(speed, 1e-12))
        change = wanted - before
        size = math.sqrt(change @ change)
        return before + change * min(1.0, self._config.max_tip_acceleration_mps2 * dt / max(size, 1e-12))

    def _tip_in_world(self) -> Array:
        return self._configuration.world_from_shaft[:3, 3].copy()
