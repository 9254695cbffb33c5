"""The operating theatre: the simulated world that sensors look at and controllers act on."""

import copy
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from laploop.arrays import Array
from laploop.assets.instrument import TIP_CONTACT
from laploop.assets.laparoscope import CAMERA, PROJECTOR
from laploop.assets.tissue_mesh import TissueMesh
from laploop.envs.theatre.actuation import Actuation
from laploop.envs.theatre.arm import Arm
from laploop.envs.theatre.clock_rates import ClockRates
from laploop.envs.theatre.config import TheatreConfig
from laploop.envs.theatre.physics_call import PhysicsCall, PhysicsRun, run_alone
from laploop.envs.theatre.scene import scene_of
from laploop.envs.theatre.stage import Stage
from laploop.envs.theatre.step_log import StepLog, distance_from_axis
from laploop.envs.theatre.theatre_model import CAMERA_ARM, INSTRUMENT_PREFIX, SCOPE_PREFIX, TISSUE_FLEX, TOOL_ARM
from laploop.envs.theatre.tissue import Tissue
from laploop.envs.theatre.trocar import Trocar
from laploop.errors import InvalidValueError, SimulationError

_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
"""What MuJoCo needs to go on to the same bits."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TheatreState:
    """What changes in a theatre while it runs."""

    physics: Array
    """MuJoCo's own state, with stage and warm start."""
    steps: int
    """Physics steps since the reset."""
    contact_force: Array
    """(3,), N, on the tip in the last step."""
    references: dict[str, Actuation]
    """Of each arm: its targets, those in flight included."""
    trocars: dict[str, dict[str, Any]]
    log: dict[str, Any]


class Theatre:
    """Two arms, the scope, the instrument, and a tissue that moves with its stage; one seed makes one theatre.

    The world is z up, metres, with its origin on the table top under the middle of the phantom.
    """

    def __init__(
        self, config: TheatreConfig, rates: ClockRates | None = None, *, seed: int = 0, solid: TissueMesh | None = None
    ) -> None:
        """Build, compile and settle a theatre.

        Args:
            config: What it is made of.
            rates: The physics step, and the control period over which a joint target is extrapolated by its velocity.
            seed: Decides the tissue, the phases of its motion and where the tip starts, unless the configuration does.
            solid: A phantom in place of the configuration's.

        Raises:
            InvalidValueError: If trocar or actuation do not fit the physics step.
        """
        self.config = config
        self.rates = rates or ClockRates()
        config.check_timestep(self.rates.physics_ns)
        own_seed = seed if config.seed is None else config.seed
        scene = scene_of(config, own_seed, timestep_s=self.rates.physics_s, solid=solid)
        self.motion = config.motion.with_phases(np.random.default_rng(own_seed).spawn(2)[1])
        self.working_distance_m = scene.working_distance_m
        self.camera_arm = scene.camera_arm
        self.tool_arm = scene.tool_arm
        self.model = scene.model
        self.data = mujoco.MjData(scene.model)
        self.tissue = Tissue(self.model, self.data, flex_name=TISSUE_FLEX, mesh=scene.tissue_mesh)
        self.stage = Stage(
            self.model,
            self.data,
            middle=scene.stage_in_world,
            motion=self.motion,
            travel=config.travel,
            timestep_ns=self.rates.physics_ns,
        )
        self._camera_site = self.model.site(f"{CAMERA_ARM}/{SCOPE_PREFIX}{CAMERA}").id
        self._projector_site = self.model.site(f"{CAMERA_ARM}/{SCOPE_PREFIX}{PROJECTOR}").id
        self._tip_geom = int(self.model.geom(f"{TOOL_ARM}/{INSTRUMENT_PREFIX}{TIP_CONTACT}").id)
        self._settled_qpos = scene.settled_qpos
        self._steps = 0
        self._references: dict[str, Actuation] = {}
        camera_trocar, tool_trocar = (Trocar(config.trocar, arm, self.model, self.data) for arm in self.arms)
        self._trocars = {self.camera_arm.name: camera_trocar, self.tool_arm.name: tool_trocar}
        self.log = StepLog(self.data, self.arms, (camera_trocar, tool_trocar), self.rates.physics_steps_per_control)
        """The physics steps of the newest control period."""
        self.reset()

    @property
    def arms(self) -> tuple[Arm, Arm]:
        """Camera arm and tool arm."""
        return self.camera_arm, self.tool_arm

    @property
    def now_ns(self) -> int:
        """Simulated time in whole nanoseconds."""
        return self._steps * self.rates.physics_ns

    def reset(self) -> None:
        """Go back to time 0: arms at home and at rest, tissue settled under its weight."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = self._settled_qpos
        self._steps = 0
        self._contact_force = np.zeros(3)
        for arm in self.arms:
            self._references[arm.name] = Actuation(
                self.config.actuation,
                q=arm.home_q,
                timestep_ns=self.rates.physics_ns,
                control_steps=self.rates.physics_steps_per_control,
            )
            self.data.ctrl[arm.actuator_indices] = arm.home_q
        mujoco.mj_kinematics(self.model, self.data)
        self.refresh()
        for trocar in self._trocars.values():
            trocar.reset()
        self.log.reset()
        self._check()

    def step(self) -> None:
        """Advance by one physics step; poses and tissue are then those of its end.

        Raises:
            SimulationError: If the state became invalid or MuJoCo gave a warning.
        """
        run_alone(self.stepping())

    def stepping(self) -> PhysicsRun[None]:
        """As `step`, stopping where MuJoCo computes."""
        for arm in self.arms:
            self.data.ctrl[arm.actuator_indices] = self._references[arm.name].step(self.now_ns)
        # Positions are fresh, and forces are still to be summed: `mj_step` in two halves, the second first.
        if self.config.trocar.acts:
            for trocar in self._trocars.values():
                trocar.apply()
        yield PhysicsCall(mujoco.mj_step2, self.model, self.data)
        collided = False
        if self.data.ncon:
            self._contact_force = self._summed_contact_force()
            # Contacts of the tissue name no geom on its side.
            collided = bool((self.data.contact.geom >= 0).all(axis=1).any())
        elif self._contact_force.any():
            self._contact_force = np.zeros(3)
        self._steps += 1
        yield from self._refreshing()
        self.log.add(self.contact_force_in_world(), collided=collided)
        self._check()

    def refresh(self) -> None:
        """Bring stage, poses, tissue and contacts up to the present state; needed after a change to it from outside."""
        run_alone(self._refreshing())

    def get_state(self) -> TheatreState:
        """Return everything in which this theatre differs from another one of the same configuration and seed."""
        physics = np.empty(mujoco.mj_stateSize(self.model, _STATE))
        mujoco.mj_getState(self.model, self.data, physics, _STATE)
        return TheatreState(
            physics=physics,
            steps=self._steps,
            contact_force=self._contact_force.copy(),
            references=copy.deepcopy(self._references),
            trocars={name: trocar.get_state() for name, trocar in self._trocars.items()},
            log=self.log.get_state(),
        )

    def set_state(self, state: TheatreState) -> None:
        """Take over what `get_state` of a theatre of the same configuration and seed has returned."""
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, state.physics, _STATE)
        self._steps = state.steps
        self._contact_force = state.contact_force.copy()
        self._references = copy.deepcopy(state.references)
        # Brings back what follows from the state, as at the end of the step after which it was taken. The stage is in place:
        # its velocity is part of the state, and to place it anew would take the contact body's orientation of now, a step late.
        mujoco.mj_step1(self.model, self.data)
        for name, trocar in self._trocars.items():
            trocar.set_state(state.trocars[name])
        self.log.set_state(state.log)

    def set_joint_targets(self, arm: Arm, q: Array, qdot: Array | None = None) -> None:
        """Send an arm's servos targets for one control period: angles, (6,) rad, and velocities, (6,) rad/s.

        Raises:
            InvalidValueError: If the arm is not of this theatre, or q or qdot is not six finite numbers.
        """
        if arm.name not in self._references:
            raise InvalidValueError("arm", arm.name, f"one of {', '.join(self._references)}")
        self._references[arm.name].command(self.now_ns, q, qdot)

    def joint_positions(self, arm: Arm) -> Array:
        """Return the joint angles, (6,)."""
        return np.asarray(self.data.qpos[arm.qpos_indices])

    def joint_velocities(self, arm: Arm) -> Array:
        """Return the joint speeds, (6,)."""
        return np.asarray(self.data.qvel[arm.dof_indices])

    def world_from_camera(self) -> Array:
        """Return the pose of the camera channel, 4x4, computer-vision frame."""
        return self._site_pose(self._camera_site)

    def world_from_projector(self) -> Array:
        """Return the pose of the projector channel, 4x4, computer-vision frame."""
        return self._site_pose(self._projector_site)

    def world_from_shaft(self, arm: Arm) -> Array:
        """Return the pose of the frame at the tip of an arm's shaft, 4x4, z along the shaft."""
        return self._site_pose(arm.tip_site)

    def tip_in_world(self) -> Array:
        """Return the centre of the tool's ball end, (3,)."""
        return np.array(self.data.site_xpos[self.tool_arm.tip_site])

    def tip_velocity_in_world(self, arm: Arm | None = None) -> Array:
        """Return the velocity of the tip of an arm's shaft, (3,), m/s; by default of the centre of the tool's ball end."""
        arm = arm or self.tool_arm
        jacobian = np.zeros((3, self.model.nv))
        mujoco.mj_jacSite(self.model, self.data, jacobian, None, arm.tip_site)
        columns = arm.dof_indices
        return np.asarray(jacobian[:, columns] @ self.data.qvel[columns])

    def contact_force_in_world(self) -> Array:
        """Return the force in newtons, (3,), of whatever touches the tool's tip, on the tip, in the last step.

        It is what an ideal sensor behind the tip reads, tared for the weight of the tip: the sum over its contacts.
        """
        return self._contact_force.copy()

    def port_force_n(self, arm: Arm) -> float:
        """Return the force in newtons with which the wall around an arm's trocar pushed its shaft sideways in the last step."""
        return self._trocars[arm.name].lateral_force_n

    def port_friction_n(self, arm: Arm) -> float:
        """Return the force in newtons with which the seal held an arm's shaft along its axis in the last step."""
        return self._trocars[arm.name].friction_force_n

    def rcm_error_m(self, arm: Arm) -> float:
        """Return the distance between an arm's trocar point and the axis of its shaft."""
        pose = self.world_from_shaft(arm)
        return float(distance_from_axis(arm.trocar_in_world, pose[:3, 3], pose[:3, 2]))

    def _refreshing(self) -> PhysicsRun[None]:
        self.stage.place(self.now_ns)
        yield PhysicsCall(mujoco.mj_step1, self.model, self.data)

    def _summed_contact_force(self) -> Array:
        force = np.zeros(3)
        wrench = np.zeros(6)
        geoms = self.data.contact.geom
        for index in np.flatnonzero((geoms == self._tip_geom).any(axis=1)):
            mujoco.mj_contactForce(self.model, self.data, index, wrench)
            # The normal points from the first to the second of the pair, and the force acts on the second.
            sign = 1.0 if geoms[index, 1] == self._tip_geom else -1.0
            force += sign * (wrench[:3] @ self.data.contact.frame[index].reshape(3, 3))
        return force

    def _site_pose(self, site: int) -> Array:
        pose = np.eye(4)
        pose[:3, :3] = self.data.site_xmat[site].reshape(3, 3)
        pose[:3, 3] = self.data.site_xpos[site]
        return pose

    def _check(self) -> None:
        """Raise if MuJoCo counted a warning (which includes NaN and huge values in position, velocity, acceleration)."""
        counts = self.data.warning.number
        if counts.any():
            names = [mujoco.mjtWarning(int(index)).name for index in np.flatnonzero(counts)]
            raise SimulationError(f"MuJoCo warned of {', '.join(names)} at {self.now_ns * 1e-9:.3f} s of simulated time")
