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
        self._arms = {"camera": theatre.camera_arm, "tool": theatre.tool_arm}
        self._models = dict(models)
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

    def stepped(self) -> None:
        """Take in the theatre's state after a physics step."""
        worst, theatre = self.worst, self._theatre
        ends: dict[str, tuple[Array, Array]] = {}
        wall = theatre.config.layout.wall_z_m
        for name, arm in self._arms.items():
            model = self._models[name]
            position = _most(theatre.joint_positions(arm) / model.upper_position)
            worst.joint_position_share = max(worst.joint_position_share, position)
            speed = _most(theatre.joint_velocities(arm) / model.max_joint_speed)
            worst.joint_speed_share = max(worst.joint_speed_share, speed)
            pose = theatre.world_from_shaft(arm)
            tip, axis = pose[:3, 3], pose[:3, 2]
            flange = tip - arm.shaft.length_m * axis
            ends[name] = tip, flange
            # The lowest point of the holder, a cylinder along the shaft.
            holder = flange[2] + _HOLDER_M[name] * axis[2] - _HOLDER_RADIUS_M * math.sqrt(max(0.0, 1.0 - axis[2] ** 2))
            worst.wall_room_mm = min(worst.wall_room_mm, 1e3 * float(wall - tip[2]), 1e3 * float(holder - wall))
        worst.shaft_room_mm = min(worst.shaft_room_mm, 1e3 * self._shaft_room(ends["camera"], ends["tool"]))
        # Contacts of the tissue name no geom on its side.
        worst.collision_steps += bool((theatre.data.contact.geom >= 0).all(axis=1).any())

    def _shaft_room(self, one: tuple[Array, Array], other: tuple[Array, Array]) -> float:
        s, t = nearest_parameters(*(end.tolist() for end in (*one, *other)))
        apart = one[0] + s * (one[1] - one[0]) - other[0] - t * (other[1] - other[0])
        radii = sum(0.5 * arm.shaft.diameter_m for arm in self._arms.values())
        return float(np.linalg.norm(apart)) - radii


def _most(fractions: Array) -> float:
    return float(np.abs(fractions).max())
