"""How the tissue comes to rest under its own weight, before an episode."""

from typing import Any

import mujoco
import numpy as np

from laploop.arrays import Array
from laploop.envs.theatre.arm import Arm
from laploop.errors import SimulationError

_STEP_S = 1.0
_STEPS = 6
_AT_REST_M_S = 1e-6


def settled_positions(model: Any, arms: tuple[Arm, Arm]) -> Array:
    """Return `qpos`, (nq,), with the arms at home and the tissue at rest, the stage in its middle.

    Elasticity is integrated implicitly, so that a step as long as many periods of the tissue's vibrations ends next to the
    equilibrium: six of them get closer to it than seconds of simulation.

    Raises:
        SimulationError: If the tissue does not come to rest.
    """
    data = mujoco.MjData(model)
    timestep_s = model.opt.timestep
    try:
        model.opt.timestep = _STEP_S
        for _ in range(_STEPS):
            _hold(data, arms)
            mujoco.mj_step(model, data)
    finally:
        model.opt.timestep = timestep_s
    _hold(data, arms)
    fastest = float(np.abs(data.qvel).max())
    if not fastest < _AT_REST_M_S or data.warning.number.any():
        raise SimulationError(f"the tissue does not come to rest: {fastest:.2g} m/s are left; allowed: {_AT_REST_M_S} m/s")
    return np.array(data.qpos)


def _hold(data: Any, arms: tuple[Arm, Arm]) -> None:
    """Put the arms back: their servos are not made for such steps."""
    for arm in arms:
        data.qpos[arm.qpos_indices] = arm.home_q
        data.qvel[arm.dof_indices] = 0.0
        data.ctrl[arm.actuator_indices] = arm.home_q
