"""The motorised stage under the phantom, which moves as the organ does."""

from typing import Any

import numpy as np

from laploop.arrays import Array
from laploop.envs.theatre.organ_motion import BaseMotion, StageTravel
from laploop.envs.theatre.theatre_model import STAGE_BODIES, STAGE_JOINTS


class Stage:
    """Puts plate and phantom where the motion has them, and shows their velocity to contacts.

    MuJoCo takes a prescribed body for one at rest: a tip that follows receding tissue would count as hitting it, and kick the
    tissue away. So the instrument's contact body carries joints that move with minus the stage's velocity, from the same place
    in every step; relative velocities in contacts are then the true ones.
    """

    def __init__(
        self, model: Any, data: Any, *, middle: Array, motion: BaseMotion, travel: StageTravel, timestep_ns: int
    ) -> None:
        """Move the stage of a compiled theatre.

        Args:
            model: The model.
            data: Its state.
            middle: (3,), metres, where the middle of the plate's upper face is without motion.
            motion: Motion along z.
            travel: Motion along x and y.
            timestep_ns: The physics step.
        """
        self._data = data
        self._middle = middle
        self._motion = motion
        self._travel = travel
        self._timestep_ns = timestep_ns
        self._mocap = np.array([model.body(name).mocapid[0] for name in STAGE_BODIES])
        joints = [model.joint(name) for name in STAGE_JOINTS]
        self._qpos = np.array([joint.qposadr[0] for joint in joints])
        self._dofs = np.array([joint.dofadr[0] for joint in joints])
        self._world_from_contact = data.xmat[int(model.jnt_bodyid[joints[0].id])].reshape(3, 3)
        self._next_ns, self._next = -1, middle

    def position(self, now_ns: int) -> Array:
        """Return where the middle of the plate's upper face is at a time, (3,), metres in the world."""
        time_s = now_ns * 1e-9
        return np.asarray(self._middle + [*self._travel.displacement(time_s), self._motion.displacement(time_s)])

    def place(self, now_ns: int) -> None:
        """Bring the stage to its place for the physics step that begins now, with the velocity that it has in that step."""
        here = self._next if now_ns == self._next_ns else self.position(now_ns)
        self._next_ns = now_ns + self._timestep_ns
        self._next = self.position(self._next_ns)
        velocity = (self._next - here) / (self._timestep_ns * 1e-9)
        self._data.mocap_pos[self._mocap] = here
        self._data.qpos[self._qpos] = 0.0
        self._data.qvel[self._dofs] = -velocity @ self._world_from_contact
