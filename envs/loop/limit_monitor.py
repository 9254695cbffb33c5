"""Whether the arms keep within their limits and clear of the wall, of each other and of the table."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from laploop.arrays import Array
from laploop.assets.instrument import HOLDER_LENGTH_M as INSTRUMENT_HOLDER_M
from laploop.assets.laparoscope import HOLDER_LENGTH_M as LAPAROSCOPE_HOLDER_M
from laploop.control.arm.clearance_limits import nearest_parameters
from laploop.control.arm.model import ArmModel
from laploop.control.arm.rcm_config import RcmControllerConfig
from laploop.envs.theatre.theatre import Theatre

_HOLDER_M = {"camera": LAPAROSCOPE_HOLDER_M, "tool": INSTRUMENT_HOLDER_M}
_HOLDER_RADIUS_M = 0.020
"""Of the thicker of the two holders."""


@dataclass(kw_only=True)
class MotionExtremes:
    """The worst of an episode, over both arms and all physics steps; 1 is at the limit."""

    joint_position_share: float = 0.0
    """Joint angle over the arm's limit, from the simulator's state."""
    joint_speed_share: float = 0.0
    """Joint speed over the arm's limit, from the simulator's state."""
    command_speed_share: float = 0.0
    """Commanded joint speed over the controller's limit."""
    command_acceleration_share: float = 0.0
    """Change of the commanded joint velocity in a control period over what the controller's limit of acceleration allows."""
    shaft_room_mm: float = math.inf
    """Least clearance between the surfaces of the two shafts."""
    wall_room_mm: float = math.inf
    """Least of the tips' depths below the wall and of the holders' heights above it."""
    collision_steps: int = 0
    """Physics steps in which rigid bodies touched: arms, what they hold, and the table."""


class LimitMonitor:
    """Keeps the extremes of an episode; reads the theatre and changes nothing."""

    def __init__(self, theatre: Theatre, models: Mapping[str, ArmModel], config: RcmControllerConfig, control_s: float) -> None:
        self.worst = MotionExtremes()
        self._theatre = theatre
        arms = {"camera": theatre.camera_arm, "tool": theatre.tool_arm}
        self._upper_position = np.stack([models[name].upper_position for name in arms])
        self._max_speed = np.stack([models[name].max_joint_speed for name in arms])
        self._length = np.array([arm.shaft.length_m for arm in arms.values()])
        self._radii = sum(0.5 * arm.shaft.diameter_m for arm in arms.values())
        self._holder = np.array([_HOLDER_M[name] for name in arms])
        self._command_speed = {
            name: np.minimum(model.max_joint_speed, config.max_joint_speed_radps) for name, model in models.items()
        }
        self._command_change = config.max_joint_acceleration_radps2 * control_s
        self._last = {name: np.zeros(model.dof) for name, model in models.items()}

    def commanded(self, arm: str, qdot: Array) -> None:
        """Take in the joint velocities, (6,) rad/s, that an arm is to follow for one control period."""
        worst, change = self.worst, qdot - self._last[arm]
        worst.command_speed_share = max(worst.command_speed_share, _most(qdot / self._command_speed[arm]))
        worst.command_acceleration_share = max(worst.command_acceleration_share, _most(change / self._command_change))
        self._last[arm] = qdot

    def period_over(self) -> None:
        """Take in the physics steps of the control period that has just ended."""
        worst, log, wall = self.worst, self._theatre.log, self._theatre.config.layout.wall_z_m
        worst.joint_position_share = max(worst.joint_position_share, _most(log.joints / self._upper_position))
        worst.joint_speed_share = max(worst.joint_speed_share, _most(log.joint_speeds / self._max_speed))
        flange = log.tip - self._length[:, None] * log.axis
        # The lowest point of the holder, a cylinder along the shaft.
        upright = log.axis[..., 2]
        holder = flange[..., 2] + self._holder * upright - _HOLDER_RADIUS_M * np.sqrt(np.maximum(0.0, 1.0 - upright**2))
        room_m = min(float(wall - log.tip[..., 2].max()), float(holder.min() - wall))
        worst.wall_room_mm = min(worst.wall_room_mm, 1e3 * room_m)
        for tips, flanges in zip(log.tip, flange, strict=True):
            worst.shaft_room_mm = min(worst.shaft_room_mm, 1e3 * self._shaft_room(tips, flanges))
        worst.collision_steps += int(log.collided.sum())

    def joint_shares(self) -> tuple[Array, Array]:
        """Return joint angles and speeds over the limits, both (2, 6), camera arm first, worst of the newest period."""
        log = self._theatre.log
        position, speed = log.joints / self._upper_position, log.joint_speeds / self._max_speed
        return np.asarray(np.abs(position).max(axis=0)), np.asarray(np.abs(speed).max(axis=0))

    def _shaft_room(self, tips: Array, flanges: Array) -> float:
        """Return the clearance between both shafts, metres, from their ends, (2, 3) each."""
        s, t = nearest_parameters(tips[0], flanges[0], tips[1], flanges[1])
        apart = tips[0] + s * (flanges[0] - tips[0]) - tips[1] - t * (flanges[1] - tips[1])
        return math.sqrt(apart @ apart) - self._radii


def _most(fractions: Array) -> float:
    return float(np.abs(fractions).max())
