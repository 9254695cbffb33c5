"""What actions mean.

| mode | space | meaning |
|---|---|---|
| `tip-velocity` | `Box(-0.06, 0.06, (3,))` | velocity of the moved tip in m/s along the camera's axes |
| `tip-offset` | `Box(-0.00048, 0.00048, (3,))` | way in m that the tip's reference goes in one control period, same axes |
| `joint-velocity` | `Box(-0.5, 0.5, (6,))` | joint velocities of the moved arm in rad/s |
| `residual` | `Box(-0.06, 0.06, (3,))` | velocity that is added to the scripted controller's |

Larger values are clipped. In every mode the trocar is kept: joint velocities are replaced by the nearest ones that leave the
shaft on its trocar, and the tip velocity that they produce then takes the usual way, through the same quadratic program with
the trocar as equality and all limits. The roll about the shaft stays with the arm's posture.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium import spaces

from laploop.arrays import Array, Float32
from laploop.control.messages import ControlInput, TipController
from laploop.envs.loop.closed_loop import ClosedLoop
from laploop.envs.tasks.task_config import TaskConfig
from laploop.errors import InvalidValueError

JOINTS = 6


def action_space(config: TaskConfig) -> spaces.Space[Float32]:
    """Return the space of the actions of a config."""
    bound = action_bound(config)
    box: spaces.Space[Any] = spaces.Box(-bound, bound, (action_size(config),), np.float32)
    return box


def action_size(config: TaskConfig) -> int:
    """Return the number of components of an action."""
    return JOINTS if config.action_mode == "joint-velocity" else 3


def action_bound(config: TaskConfig) -> float:
    """Return the bound of each component of an action."""
    if config.action_mode == "joint-velocity":
        return config.max_joint_speed_radps
    if config.action_mode == "tip-offset":
        return config.max_tip_speed_mps * config.loop.control_s
    return config.max_tip_speed_mps


def checked_action(action: object, config: TaskConfig) -> Array:
    """Return an action as float64.

    Raises:
        InvalidValueError: If it has another shape or is not made of real numbers, or is not finite where that is an error.
    """
    unit = {"joint-velocity": "rad/s", "tip-offset": "m"}.get(config.action_mode, "m/s")
    return _checked(action, config, unit)


def scaled_action(action: object, config: TaskConfig) -> Array:
    """Return what an action of -1 to 1 a component stands for, float64, -1 and 1 being the bounds; larger ones are clipped.

    Raises:
        InvalidValueError: As for `checked_action`.
    """
    return np.clip(_checked(action, config, "-1 to 1"), -1.0, 1.0) * action_bound(config)


def checked_command(command: object) -> Array:
    """Return a tip controller's command as float64; entries that are not finite are left to the environment.

    Raises:
        InvalidValueError: If it is not three real numbers.
    """
    return _real_numbers("command of the controller", command, 3, "velocity of the tip in m/s")


def _checked(action: object, config: TaskConfig, unit: str) -> Array:
    size = action_size(config)
    values = _real_numbers("action", action, size, unit)
    if config.bad_action == "raise" and not np.isfinite(values).all():
        raise InvalidValueError("action", values.tolist(), f"{size} finite numbers ({unit})")
    return values


def _real_numbers(name: str, values: object, size: int, unit: str) -> Array:
    allowed = f"{size} finite numbers ({unit})"
    try:
        array = np.asarray(values)
    except ValueError as error:
        raise InvalidValueError(name, values, allowed) from error
    if array.dtype.kind not in "fiu" or array.shape != (size,):
        raise InvalidValueError(name, values, allowed)
    return array.astype(np.float64)


class ActionInterpreter:
    """Turns the actions of an episode into velocities of the moved tip."""

    def __init__(self, config: TaskConfig, loop: ClosedLoop, controller: TipController | None, *, yields: bool) -> None:
        """Add residuals to what the controller commands; a tip that `yields` gives way to tissue that presses on it."""
        self._config = config
        self._loop = loop
        # In the other modes nobody asks it.
        self._controller = controller if config.action_mode == "residual" else None
        self._yields = yields
        self.fault: str | None = None
        """Why the last action was not followed: `action_not_finite`, `controller_not_finite`, or None."""

    def reset(self) -> None:
        """Begin an episode."""
        self.fault = None
        if self._controller is not None:
            self._controller.reset()

    @property
    def depth_jump_fraction(self) -> float | None:
        """What the controller that residuals are added to rejects of the newest depth; None where none acts, or it has none."""
        fraction: float | None = getattr(self._controller, "depth_jump_fraction", None)
        return fraction

    def velocity(self, action: Array, known: Callable[[], ControlInput]) -> Array:
        """Return the velocity of the moved tip, (3,) m/s along the camera's axes, that a checked action stands for.

        What a controller may know now is asked for only where it is needed.
        """
        config = self._config
        action = self._loop.injector.action(action, self._loop.now_ns)
        self.fault = None
        command = np.zeros(3)
        if self._controller is not None:
            with self._loop.timer.measure("control"):
                command = checked_command(self._controller.command(known()))
            if not np.isfinite(command).all():
                self.fault = "controller_not_finite"
        if not np.isfinite(action).all():
            self.fault = "action_not_finite"
        if self.fault is not None:
            return self._held(self._loop.control_input(np.zeros(2), with_depth=False))
        bound = action_bound(config)
        action = np.clip(action, -bound, bound)
        if config.action_mode == "joint-velocity":
            return self._loop.tip_velocity_of_joints(action)
        if config.action_mode == "tip-offset":
            return action / config.loop.control_s
        return action + command

    def _held(self, known: ControlInput) -> Array:
        """Return the velocity of a tip without a command: it stands still, but lets moving tissue push it out of its way."""
        axis = known.shaft_axis_in_camera
        if not self._yields or axis is None or known.contact_force_n <= self._config.yield_force_n:
            return np.zeros(3)
        return -self._config.yield_speed_mps * axis
