"""What the last physics steps left behind, for whoever looks at them once a control period."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from laploop.arrays import Array
from laploop.envs.theatre.arm import Arm
from laploop.envs.theatre.trocar import Trocar


def distance_from_axis(points: Array, on_axis: Array, axis: Array) -> Array:
    """Return the distance of points from axes, (...), given a point on each and its unit vector, all (..., 3), metres."""
    offset = points - on_axis
    along = (offset * axis).sum(axis=-1, keepdims=True)
    return np.asarray(np.linalg.norm(offset - along * axis, axis=-1))


class StepLog:
    """The physics steps of the newest control period, a row each, in no particular order once it is full.

    Columns of arms are those of the camera arm and the tool arm, in this order. Poses, angles and speeds are those at the end
    of the step, forces those that acted in it.
    """

    def __init__(self, data: Any, arms: tuple[Arm, Arm], trocars: tuple[Trocar, Trocar], steps: int) -> None:
        """Keep the newest `steps` steps of a theatre."""
        self._data = data
        self._trocars = trocars
        self._sites = np.array([arm.tip_site for arm in arms])
        self._qpos = np.stack([arm.qpos_indices for arm in arms])
        self._dofs = np.stack([arm.dof_indices for arm in arms])
        self._ports = np.stack([arm.trocar_in_world for arm in arms])
        self._count = 0
        self.tip: Array = np.zeros((steps, 2, 3))
        """(steps, 2, 3), metres in the world: the tips of both shafts."""
        self.axis: Array = np.zeros((steps, 2, 3))
        """(steps, 2, 3), unit vectors along the shafts, towards the tips."""
        self.joints: Array = np.zeros((steps, *self._qpos.shape))
        """(steps, 2, 6), rad."""
        self.joint_speeds: Array = np.zeros((steps, *self._dofs.shape))
        """(steps, 2, 6), rad/s."""
        self.port_force_n: Array = np.zeros((steps, 2))
        """(steps, 2): of the wall across the shaft."""
        self.port_friction_n: Array = np.zeros((steps, 2))
        """(steps, 2): of the seal along the shaft."""
        self.contact_force: Array = np.zeros((steps, 3))
        """(steps, 3), N in the world: on the tool's tip."""
        self.collided: NDArray[np.bool_] = np.zeros(steps, dtype=np.bool_)
        """(steps,): whether rigid bodies touched: arms, what they hold, and the table."""

    @property
    def rcm_error_m(self) -> Array:
        """(steps, 2): distance of each trocar point from the axis of its shaft."""
        return distance_from_axis(self._ports, self.tip, self.axis)

    def reset(self) -> None:
        """Fill all rows with the present state, without forces."""
        self._count = 0
        for _ in range(len(self.tip)):
            self.add(np.zeros(3), collided=False)

    def get_state(self) -> dict[str, Any]:
        """Return a copy of the rows."""
        return {name: value.copy() for name, value in self._rows().items()} | {"count": self._count}

    def set_state(self, state: dict[str, Any]) -> None:
        """Take over what `get_state` has returned."""
        self._count = state["count"]
        for name, rows in self._rows().items():
            rows[:] = state[name]

    def _rows(self) -> dict[str, NDArray[Any]]:
        return {name: value for name, value in vars(self).items() if not name.startswith("_")}

    def add(self, contact_force: Array, *, collided: bool) -> None:
        """Keep a step that has just ended; kinematics must be fresh.

        Args:
            contact_force: (3,), N in the world, on the tool's tip.
            collided: Whether rigid bodies touched.
        """
        row = self._count % len(self.tip)
        self._count += 1
        data = self._data
        self.tip[row] = data.site_xpos[self._sites]
        self.axis[row] = data.site_xmat[self._sites, 2::3]
        self.joints[row] = data.qpos[self._qpos]
        self.joint_speeds[row] = data.qvel[self._dofs]
        for column, trocar in enumerate(self._trocars):
            self.port_force_n[row, column] = trocar.lateral_force_n
            self.port_friction_n[row, column] = trocar.friction_force_n
        self.contact_force[row] = contact_force
        self.collided[row] = collided
