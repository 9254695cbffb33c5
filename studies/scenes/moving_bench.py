"""Physics of the paper's bench: a deformable phantom on a stage that moves to a commanded pose and settles there."""

import math
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from laploop.assets.instrument import VISIBLE_GROUP
from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.shafts import LAPAROSCOPE
from laploop.assets.tissue_config import TissueConfig
from laploop.assets.ur5 import ARM_GROUP
from laploop.errors import SimulationError
from laploop.studies.scenes.training_scene import TIMESTEP_S, TrainingScene

Array = NDArray[np.float64]

SCOPE_SEES = (VISIBLE_GROUP,)
REFERENCE_SEES = (VISIBLE_GROUP, ARM_GROUP)
"""Groups of geoms and flexes. The reference camera also sees the scope's shaft, which hides tissue behind it."""

SPEED_M_S = 0.2
TURN_RAD_S = 2.0 * math.pi
"""Largest speeds of the stage: a fast laboratory stage with a turntable."""
SETTLED_M_S = 1e-4
"""A slower surface moves by less than a micrometre during an exposure."""
SETTLE_LIMIT_S = 3.0
_QUIET_STEPS = 5
_PEAK_OVER_MEAN = 1.875
"""Peak over mean speed of a minimum-jerk motion."""


class BenchScene(TrainingScene):
    """A tissue on a stage below a fixed scope, at rest at `home` until it is moved.

    World: that of `OpticalBench`. Every motion starts from the tissue at rest at `home`, so that it does not depend on earlier
    ones.
    """

    def __init__(
        self,
        config: TissueConfig,
        rng: np.random.Generator,
        *,
        world_from_scope: Array,
        scope: ScopeOptics,
        home: Callable[[float], Array],
    ) -> None:
        """Grow one tissue from `rng`, put it on the stage at home, and let it come to rest.

        `home` returns the stage's pose, 4x4, for a mean height of the tissue above it, metres.

        Raises:
            SimulationError: If it does not come to rest, or the physics becomes invalid.
        """
        super().__init__(config, rng, furnish=_shaft(world_from_scope, scope))
        self._home = home(self.mean_height_m)
        self._place_stage(self._home)
        self.settle()
        self._at_rest = np.zeros(mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_INTEGRATION))
        mujoco.mj_getState(self.model, self.data, self._at_rest, mujoco.mjtState.mjSTATE_INTEGRATION)

    def move_stage(self, world_from_stage: Array) -> float:
        """Move the stage from home to a pose (4x4, middle of its upper face) at bounded speed.

        Position and orientation follow the same minimum-jerk course.

        Returns:
            The time taken, seconds.
        """
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, self._at_rest, mujoco.mjtState.mjSTATE_INTEGRATION)
        shift = world_from_stage[:3, 3] - self._home[:3, 3]
        turn = Rotation.from_matrix(world_from_stage[:3, :3] @ self._home[:3, :3].T).as_rotvec()
        mean_time = max(float(np.linalg.norm(shift)) / SPEED_M_S, float(np.linalg.norm(turn)) / TURN_RAD_S)
        steps = max(1, math.ceil(_PEAK_OVER_MEAN * mean_time / TIMESTEP_S))
        for step in range(1, steps + 1):
            t = step / steps
            course = t**3 * (10.0 - 15.0 * t + 6.0 * t * t)
            pose = np.eye(4)
            pose[:3, :3] = Rotation.from_rotvec(course * turn).as_matrix() @ self._home[:3, :3]
            pose[:3, 3] = self._home[:3, 3] + course * shift
            self._place_stage(world_from_stage if step == steps else pose)
            self._step()
        return steps * TIMESTEP_S

    def settle(self, *, limit_s: float = SETTLE_LIMIT_S) -> tuple[float, float]:
        """Wait until the tissue's surface is still.

        Returns:
            The time taken, seconds, and the largest speed of the surface at the end, m/s.

        Raises:
            SimulationError: If it is not still within `limit_s` of simulated time, or the physics becomes invalid.
        """
        before, quiet, speed = self.surface_points(), 0, math.inf
        for step in range(1, math.ceil(limit_s / TIMESTEP_S) + 1):
            self._step()
            now = self.surface_points()
            speed = float(np.sqrt(((now - before) ** 2).sum(axis=1).max())) / TIMESTEP_S
            before = now
            quiet = quiet + 1 if speed < SETTLED_M_S else 0
            if quiet == _QUIET_STEPS:
                self._refresh()
                return step * TIMESTEP_S, speed
        raise SimulationError(
            f"the tissue still moves at {1e3 * speed:.3g} mm/s {limit_s:g} s after the stage stopped; "
            f"allowed: below {1e3 * SETTLED_M_S:g} mm/s (a stiffer or better damped material settles sooner)"
        )

    def _step(self) -> None:
        """Make a step; a warning counts as a failure, since MuJoCo silently resets after it."""
        try:
            mujoco.mj_step(self.model, self.data)
        except mujoco.FatalError as error:
            raise SimulationError(f"the tissue on the stage became invalid: {error}") from error
        counts = self.data.warning.number
        if counts.any():
            names = ", ".join(mujoco.mjtWarning(kind).name for kind in np.flatnonzero(counts))
            raise SimulationError(f"the tissue on the stage became invalid: MuJoCo warns of {names}")

    def _place_stage(self, world_from_stage: Array) -> None:
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(world_from_stage[:3, :3]).ravel())
        self.data.mocap_pos[self._stage] = world_from_stage[:3, 3]
        self.data.mocap_quat[self._stage] = quaternion


def _shaft(world_from_scope: Array, scope: ScopeOptics) -> Callable[[Any], None]:
    """Return a function that adds the scope's shaft, which begins half a baseline to the camera's right."""

    def add(spec: Any) -> None:
        pose = world_from_scope
        tip = pose[:3, 3] + 0.5 * scope.baseline_m * pose[:3, 0]
        end = tip - LAPAROSCOPE.length_m * pose[:3, 2]
        spec.worldbody.add_geom(
            name="scope/shaft",
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            fromto=[*tip, *end],
            size=[0.5 * LAPAROSCOPE.diameter_m, 0.0, 0.0],
            group=ARM_GROUP,
            contype=0,
            conaffinity=0,
            rgba=[0.1, 0.1, 0.11, 1.0],
        )

    return add
