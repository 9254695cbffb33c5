"""The operating theatre: the simulated world that sensors look at and controllers act on."""

import mujoco
import numpy as np

from laploop.arrays import Array
from laploop.assets.instrument import TIP
from laploop.assets.laparoscope import CAMERA, PROJECTOR
from laploop.assets.tissue_mesh import TissueMesh
from laploop.envs.theatre.actuation import Actuation
from laploop.envs.theatre.arm import Arm
from laploop.envs.theatre.clock_rates import ClockRates
from laploop.envs.theatre.config import TheatreConfig
from laploop.envs.theatre.scene import (
    CAMERA_ARM,
    INSTRUMENT_PREFIX,
    SCOPE_PREFIX,
    STAGE_PLATE,
    TISSUE_FLEX,
    TOOL_ARM,
    build_scene,
)
from laploop.envs.theatre.tissue import Tissue
from laploop.envs.theatre.trocar import Trocar
from laploop.errors import InvalidValueError, SimulationError

_SETTLE_LIMIT_S = 2.0
_AT_REST_M_S = 1e-6


class Theatre:
    """Two arms, the scope, the instrument, and a tissue that moves with its stage; one seed makes one theatre.

    The world is z up, metres, with its origin on the table top under the middle of the phantom. Poses and points are those
    of the last `refresh` (or one physics step old after `step`, as MuJoCo leaves them).
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
        shape_rng, motion_rng = np.random.default_rng(seed if config.seed is None else config.seed).spawn(2)
        scene = build_scene(config, shape_rng, timestep_s=self.rates.physics_s, solid=solid)
        self.motion = config.motion.with_phases(motion_rng)
        self.working_distance_m = scene.working_distance_m
        self.camera_arm = scene.camera_arm
        self.tool_arm = scene.tool_arm
        self.model = scene.model
        self.data = mujoco.MjData(scene.model)
        self.tissue = Tissue(self.model, self.data, flex_name=TISSUE_FLEX, mesh=scene.tissue_mesh)
        self._stage_in_world = scene.stage_in_world
        self._stage_mocap = int(self.model.body(STAGE_PLATE).mocapid[0])
        self._camera_site = self.model.site(f"{CAMERA_ARM}/{SCOPE_PREFIX}{CAMERA}").id
        self._projector_site = self.model.site(f"{CAMERA_ARM}/{SCOPE_PREFIX}{PROJECTOR}").id
        self._tip_geoms = np.flatnonzero(self.model.geom_bodyid == self.model.body(f"{TOOL_ARM}/{INSTRUMENT_PREFIX}{TIP}").id)
        self._steps = 0
        self._references: dict[str, Actuation] = {}
        self._trocars = {arm.name: Trocar(config.trocar, arm, self.model, self.data) for arm in self.arms}
        self._settled_qpos = self._settle()
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
        for arm in self.arms:
            self._references[arm.name] = Actuation(
                self.config.actuation,
                q=arm.home_q,
                timestep_ns=self.rates.physics_ns,
                control_steps=self.rates.physics_steps_per_control,
            )
            self.data.ctrl[arm.actuator_indices] = arm.home_q
        self._place_stage()
        mujoco.mj_forward(self.model, self.data)
        for trocar in self._trocars.values():
            trocar.reset()
        self._check()

    def step(self) -> None:
        """Advance by one physics step.

        Raises:
            SimulationError: If the state became invalid or MuJoCo gave a warning.
        """
        for arm in self.arms:
            self.data.ctrl[arm.actuator_indices] = self._references[arm.name].step(self.now_ns)
        self._place_stage()
        # The two halves of `mj_step`; between them positions are fresh and forces are still to be summed.
        mujoco.mj_step1(self.model, self.data)
        if self.config.trocar.acts:
            for trocar in self._trocars.values():
                trocar.apply()
        mujoco.mj_step2(self.model, self.data)
        self._steps += 1
        self._check()

    def refresh(self) -> None:
        """Bring stage, poses, and tissue surface up to the present time; call it before any sensing."""
        self._place_stage()
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        mujoco.mj_flex(self.model, self.data)

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

    def tip_velocity_in_world(self) -> Array:
        """Return the velocity of the centre of the tool's ball end, (3,), m/s."""
        jacobian = np.zeros((3, self.model.nv))
        mujoco.mj_jacSite(self.model, self.data, jacobian, None, self.tool_arm.tip_site)
        columns = self.tool_arm.dof_indices
        return np.asarray(jacobian[:, columns] @ self.data.qvel[columns])

    def contact_force_in_world(self) -> Array:
        """Return the force in newtons, (3,), of whatever touches the tool's tip, on the tip, in the last step.

        It is what an ideal sensor behind the tip reads, tared for the weight of the tip: the sum over its contacts.
        """
        force = np.zeros(3)
        wrench = np.zeros(6)
        geoms = self.data.contact.geom
        for index in np.flatnonzero(np.isin(geoms, self._tip_geoms).any(axis=1)):
            mujoco.mj_contactForce(self.model, self.data, index, wrench)
            # The normal points from the first to the second of the pair, and the force acts on the second.
            sign = 1.0 if geoms[index, 1] in self._tip_geoms else -1.0
            force += sign * (wrench[:3] @ self.data.contact.frame[index].reshape(3, 3))
        return force

    def port_force_n(self, arm: Arm) -> float:
        """Return the force in newtons with which the wall around an arm's trocar pushed its shaft sideways in the last step."""
        return self._trocars[arm.name].lateral_force_n

    def port_friction_n(self, arm: Arm) -> float:
        """Return the force in newtons with which the seal held an arm's shaft along its axis in the last step."""
        return self._trocars[arm.name].friction_force_n

    def rcm_error_m(self, arm: Arm) -> float:
        """Return the distance between an arm's trocar point and the axis of its shaft."""
        axis = self.data.site_xmat[arm.tip_site].reshape(3, 3)[:, 2]
        offset = arm.trocar_in_world - self.data.site_xpos[arm.tip_site]
        return float(np.linalg.norm(offset - (offset @ axis) * axis))

    def _place_stage(self) -> None:
        time_s = self.now_ns * 1e-9
        moved = [*self.config.travel.displacement(time_s), self.motion.displacement(time_s)]
        self.data.mocap_pos[self._stage_mocap] = self._stage_in_world + moved

    def _settle(self) -> Array:
        """Let the tissue come to rest under gravity with the arms at home, and return the positions."""
        mujoco.mj_resetData(self.model, self.data)
        for arm in self.arms:
            self.data.qpos[arm.qpos_indices] = arm.home_q
            self.data.ctrl[arm.actuator_indices] = arm.home_q
        self._place_stage()
        for step in range(round(_SETTLE_LIMIT_S / self.rates.physics_s)):
            mujoco.mj_step(self.model, self.data)
            if step % 10 == 0 and np.abs(self.data.qvel).max() < _AT_REST_M_S:
                break
        else:
            raise SimulationError(
                f"the tissue still moves at {np.abs(self.data.qvel).max():.2g} m/s after {_SETTLE_LIMIT_S} s; "
                f"allowed: {_AT_REST_M_S} m/s"
            )
        self._check()
        qpos = np.array(self.data.qpos)
        for arm in self.arms:
            qpos[arm.qpos_indices] = arm.home_q
        return qpos

    def _site_pose(self, site: int) -> Array:
        pose = np.eye(4)
        pose[:3, :3] = self.data.site_xmat[site].reshape(3, 3)
        pose[:3, 3] = self.data.site_xpos[site]
        return pose

    def _check(self) -> None:
        """Raise if MuJoCo counted a warning (which includes NaN and huge values in position, velocity, acceleration)."""
        counts = self.data.warning.number
        if np.any(counts):
            names = [mujoco.mjtWarning(int(index)).name for index in np.flatnonzero(counts)]
            raise SimulationError(f"MuJoCo warned of {', '.join(names)} at {self.now_ns * 1e-9:.3f} s of simulated time")
