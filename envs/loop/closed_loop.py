"""Everything between a desired tip velocity and the next depth frame: physics, stripes, perception, trocar-aware control."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from laploop.arrays import Array
from laploop.control.arm.rcm_controller import RcmController, RcmStatus
from laploop.control.messages import ControlInput
from laploop.envs.loop.background import WAIT
from laploop.envs.loop.captured_frame import CapturedFrame
from laploop.envs.loop.config import LoopConfig
from laploop.envs.loop.faults import FaultInjector
from laploop.envs.loop.frame_renderer import FrameRenderer
from laploop.envs.loop.kinematic_errors import KinematicErrors
from laploop.envs.loop.limit_monitor import LimitMonitor
from laploop.envs.loop.miscalibrated_arm import MiscalibratedArm, MiscalibratedScope, MiscalibratedTool
from laploop.envs.loop.observed_theatre import ObservedTheatre
from laploop.envs.loop.perception_server import PerceptionServer, ServedFrame
from laploop.envs.loop.proprioception import Proprioception, ProprioceptiveReading
from laploop.envs.loop.savable_loop import SavableLoop
from laploop.envs.loop.stage_timer import StageTimer
from laploop.envs.loop.timing.command_path import CommandPath, JointTarget
from laploop.envs.loop.timing.config import TimingSamples
from laploop.envs.loop.timing.frame_transfer import FrameTransfer
from laploop.envs.loop.timing.log import TimingLog
from laploop.envs.recording.recorder import ARM_NAMES, FrameRecord, NullRecorder, Recorder
from laploop.envs.theatre.physics_call import PhysicsRun, run_alone
from laploop.errors import SimulationError
from laploop.perception.estimators.base import DepthEstimator
from laploop.perception.geometry import Rig, invert_transform, transform_points

MAX_WAIT_NS = 10_000_000_000
"""How long a reset waits for the first depth frame."""


class ClosedLoop(SavableLoop):
    """A theatre with its sensor, its perception stage and its arm controllers, under one clock.

    In every physics step the order is: physics, proprioception, capture if a camera period begins, arrival of depth frames. In
    every control period the joint references come first. A depth frame that a newer one has overtaken is dropped when it
    arrives, so that the newest known is never replaced by an older one.
    """

    def __init__(
        self,
        config: LoopConfig,
        estimator: DepthEstimator,
        recorder: Recorder | None = None,
        *,
        moves_scope: bool = False,
        locate_target: Callable[[], Array] | None = None,
        images: bool = True,
        depth: bool = True,
    ) -> None:
        """Keep the parts that outlive an episode; `reset` makes the rest.

        Args:
            config: The theatre, the stages and their timing.
            estimator: The perception stage.
            recorder: Receives everything that happens.
            moves_scope: Whether the camera arm is controlled; it stands still otherwise.
            locate_target: Returns where in the world the target is, (3,), for its marker; called at every capture.
            images: Whether each image will be asked for, so that it is rendered at once, while physics goes on.
            depth: The same for depth maps. What nobody asks for is not computed.
        """
        self.config = config
        self._moves_scope = moves_scope
        self._locate_target = locate_target
        self.estimator = estimator
        self.recorder: Recorder = recorder or NullRecorder()
        self.rig = Rig.from_optics(config.theatre.scope)
        self.timer = StageTimer()
        self.max_force_n = self.mean_force_n = 0.0
        self._images_ahead = images or self.recorder.takes_frames or self.recorder.takes_depth
        self._depth_ahead = depth or self.recorder.takes_depth
        self.observed = ObservedTheatre(config, self.rig, images=self._images_ahead, depth=self._depth_ahead)
        self._renderer: FrameRenderer | None = None
        self._server: PerceptionServer | None = None
        self._lasting = frozenset(vars(self)) - {"max_force_n", "mean_force_n", "_renderer", "_server"}
        self.timing = config.timing
        self.timing_changes: dict[str, Any] = {}
        """Stages that take other times in following episodes than the configuration says; `DelayRandomization` sets them."""

    def resetting(
        self, rng: np.random.Generator, *, theatre_seed: int, at_first_frame: Callable[[], None] | None = None
    ) -> PhysicsRun[None]:
        """Build the theatre and run it, arms held, until the first depth frame has arrived; stops where MuJoCo computes.

        Args:
            rng: Source of noise, of latencies, of the tissue's texture, and of the proprioceptive channels' corruption.
            theatre_seed: Decides the theatre, unless its configuration does.
            at_first_frame: Called at time 0, when the first frame has just been captured.

        Raises:
            SimulationError: If no depth frame arrives.
        """
        # They may finish what they are at while the theatre is built, and the estimator even later.
        estimating = None if self._server is None else self._server.abandon()
        if self._renderer is not None:
            self._renderer.abandon()
        noise_rng, service_rng, corruption_rng, texture_rng, tool_rng, scope_rng, timing_rng = rng.spawn(7)
        self.timer = StageTimer()
        self.theatre = self.observed.build(theatre_seed)
        if self._renderer is not None:
            self._renderer.close()
        errors = self.config.kinematic_errors
        exact = errors == KinematicErrors()
        self.tool = MiscalibratedTool(self.theatre, None if exact else errors.draw(tool_rng))
        self.scope = MiscalibratedScope(self.theatre, None if exact else errors.draw(scope_rng))
        self._tool_controller = self._controller(self.tool)
        self._scope_controller = self._controller(self.scope) if self._moves_scope else None
        self.injector = FaultInjector(self.config.faults)
        self._out_of_reach = ""
        self._renderer = FrameRenderer(self.observed.look(texture_rng), noise_rng, self.timer)
        self.timing = replace(self.config.timing, **self.timing_changes)
        samples = TimingSamples.draw(self.timing, service_rng, timing_rng)
        log = self.timing_log = TimingLog()
        self._transfer = FrameTransfer(self.timing, samples, log)
        self._server = PerceptionServer(
            self.estimator, self.timing, samples, log, self.timer, ahead=self._depth_ahead, after=estimating
        )
        self._commands = CommandPath(samples, self.config, log)
        self._proprioception = Proprioception(self.tool, self.config.proprioception, self.config)
        self._proprioception.reset(np.random.RandomState(corruption_rng.integers(2**32)))
        self.frame_count = 0
        models = {"camera": self.scope.model, "tool": self.tool.model}
        self.watch = LimitMonitor(self.theatre, models, self.config.rcm, self.config.control_s)
        self._take_extremes()
        self.first_captured: CapturedFrame | None = None
        self.newest_captured: CapturedFrame | None = None
        self.newest_served: ServedFrame | None = None
        self.recorder.begin(self.theatre, self.rig)
        self._capture_if_due()
        self._hand_over()  # perception begins while the target is chosen
        if at_first_frame is not None:
            at_first_frame()
        self._mark(self.newest_captured)
        self._deliver()
        while self.newest_served is None:
            if self.now_ns > MAX_WAIT_NS:
                raise SimulationError(f"no depth frame arrived within {MAX_WAIT_NS * 1e-9:.0f} s of simulated time")
            yield from self.advancing(np.zeros(3))

    def advance(self, tip_velocity_in_camera: Array, scope_velocity_in_camera: Array | None = None) -> list[ServedFrame]:
        """Run one control period.

        Args:
            tip_velocity_in_camera: (3,), desired velocity of the tool's tip in m/s, along the camera's axes.
            scope_velocity_in_camera: The same of the scope's tip, where it is moved; none counts as zero.

        Returns:
            The depth frames that arrived, oldest first.
        """
        return run_alone(self.advancing(tip_velocity_in_camera, scope_velocity_in_camera))

    def advancing(
        self, tip_velocity_in_camera: Array, scope_velocity_in_camera: Array | None = None
    ) -> PhysicsRun[list[ServedFrame]]:
        """As `advance`, stopping where MuJoCo computes."""
        if self.newest_served is not None:
            self.timing_log.use(self.newest_served.captured.times, self.now_ns)
        control_s = self.config.control_s
        with self.timer.measure("control"):
            rotation = self.scope.world_from_camera()[:3, :3]
            # Each shaft keeps clear of the other, where that one's nominal kinematics put it.
            self._tool_controller.set_other_shaft(self.scope.tip_pose_in_world(), self.scope.model.shaft)
            wanted = rotation @ tip_velocity_in_camera
            if self._scope_controller is None:
                wanted = self._within_reach(self.tool, self._tool_controller, wanted)
            targets = [JointTarget(self.tool, *self._tool_controller.step(wanted, control_s))]
            self.watch.commanded("tool", targets[-1].qdot)
            if self._scope_controller is not None:
                self._scope_controller.set_other_shaft(self.tool.tip_pose_in_world(), self.tool.model.shaft)
                requested = np.zeros(3) if scope_velocity_in_camera is None else rotation @ scope_velocity_in_camera
                wanted = self._within_reach(self.scope, self._scope_controller, requested)
                targets.append(JointTarget(self.scope, *self._scope_controller.step(wanted, control_s)))
                self.watch.commanded("camera", targets[-1].qdot)
        self._commands.send(self.now_ns, targets, self.timer.complete("control"))
        self._proprioception.before_control_period()
        served: list[ServedFrame] = []
        for _ in range(self.config.physics_steps_per_control):
            self._commands.deliver(self.now_ns)
            with self.timer.measure("physics"):
                yield from self.theatre.stepping()
            self.timer.complete("physics")
            self._proprioception.after_physics_step()
            self._capture_if_due()
            served += self._deliver()
        self.watch.period_over()
        self._take_extremes()
        return served

    @property
    def now_ns(self) -> int:
        """Simulated time."""
        return self.theatre.now_ns

    @property
    def newest_arrived(self) -> CapturedFrame | None:
        """The newest frame that perception, or whoever observes images, has been given."""
        return self._transfer.newest

    @property
    def dropped_frames(self) -> int:
        """Frames that were lost, for which perception had no time, or that a newer one overtook on their way from it."""
        return self.timing_log.dropped_frames

    @property
    def tool_status(self) -> RcmStatus:
        """What became of the last step of the tool arm."""
        return self._status(self._tool_controller)

    @property
    def scope_status(self) -> RcmStatus | None:
        """What became of the last step of the camera arm; None where it stands still."""
        return None if self._scope_controller is None else self._status(self._scope_controller)

    @property
    def status_reason(self) -> str:
        """What kept the moved arm from following its last command; empty while it follows."""
        reasons = self._out_of_reach, (self._scope_controller or self._tool_controller).last_reason
        return ", ".join(filter(None, reasons))

    @property
    def scope_insertion_m(self) -> float:
        """Length of the scope's shaft inside the wall, by its kinematics."""
        return float(np.linalg.norm(self.scope.trocar_in_world - self.scope.tip_pose_in_world()[:3, 3]))

    def tip_velocity_of_joints(self, qdot: Array) -> Array:
        """Return the velocity of the moved arm's tip, (3,) m/s along the camera's axes, that joint velocities produce.

        The joint velocities, (6,) rad/s, are first replaced by the nearest ones that leave the shaft on its trocar. The roll
        about the shaft stays with the arm's posture.
        """
        arm = self.scope if self._scope_controller is not None else self.tool
        controller = self._scope_controller or self._tool_controller
        return np.asarray(self.scope.world_from_camera()[:3, :3].T @ arm.tip_velocity_of_joints(controller.q, qdot))

    def reading(self) -> ProprioceptiveReading:
        """Return what the tool arm's own channels deliver now."""
        return self.injector.reading(self._proprioception.read(), self.now_ns)

    @property
    def depth_is_used(self) -> bool:
        """Whether this episode's depth maps are asked for: beforehand, or by `control_input` so far."""
        return self._server is not None and self._server.ahead

    def marker_pixel(self) -> Array | None:
        """Return where the target's marker was seen, (2,), in the frame of the newest depth map; None where it was not."""
        return None if self.newest_served is None else self.newest_served.marker_pixel(self.rig.camera)

    def control_input(self, target_pixel: Array, *, with_depth: bool = True) -> ControlInput:
        """Gather everything that a tip controller may know, except what only its task knows.

        Args:
            target_pixel: (2,), the chosen pixel of the first frame.
            with_depth: Whether to wait for the newest depth map and the marker seen with it; neither is given otherwise.

        Raises:
            SimulationError: If no episode is running.
        """
        server = self._running_server()
        if with_depth:
            # Who asks once will ask again.
            server.ahead = True
        world_from_camera = self.scope.world_from_camera()
        camera_from_world = invert_transform(world_from_camera)
        reading = self.reading()
        tip, velocity, force = reading.seen_from(camera_from_world)
        newest = self.newest_served if with_depth else None
        return ControlInput(
            now_ns=self.now_ns,
            depth=newest.depth if newest else None,
            target_pixel=target_pixel,
            tip_in_camera=tip,
            tip_velocity_in_camera=velocity,
            trocar_in_camera=transform_points(camera_from_world, self.tool.trocar_in_world),
            contact_force_n=float(np.linalg.norm(reading.contact_force_in_world)),
            contact_force_in_camera=force,
            shaft_axis_in_camera=camera_from_world[:3, :3] @ self.tool.shaft_axis_in_world(),
            scope_trocar_in_camera=transform_points(camera_from_world, self.scope.trocar_in_world),
            world_from_camera=world_from_camera,
            lead_ns=self.config.theatre.actuation.lead_ns + self.timing.command_ns,
            marker_pixel=self.marker_pixel() if with_depth else None,
        )

    def close(self) -> None:
        """End the running episode, if any, and all threads."""
        self._end_episode()
        self.observed.close()

    def _take_extremes(self) -> None:
        """Find the worst of the newest control period's physics steps."""
        log = self.theatre.log
        self.max_rcm_error_m = dict(zip(ARM_NAMES, log.rcm_error_m.max(axis=0).tolist(), strict=True))
        self.max_port_force_n = dict(zip(ARM_NAMES, log.port_force_n.max(axis=0).tolist(), strict=True))
        self.max_port_friction_n = dict(zip(ARM_NAMES, log.port_friction_n.max(axis=0).tolist(), strict=True))
        forces = np.linalg.norm(log.contact_force, axis=1)
        self.max_force_n, self.mean_force_n = float(forces.max()), float(forces.mean())

    def _running_server(self) -> PerceptionServer:
        if self._server is None:
            raise SimulationError("no episode is running; call reset() first")
        return self._server

    def _controller(self, arm: MiscalibratedArm) -> RcmController:
        controller = RcmController(arm.model, arm.trocar_in_world, self.config.rcm)
        controller.reset(arm.home_q)
        return controller

    def _within_reach(self, arm: MiscalibratedArm, controller: RcmController, wanted: Array) -> Array:
        """Return the velocity of the moved arm's tip, (3,) m/s in the world, that faults leave possible."""
        period_s, axis = self.config.control_s, arm.shaft_axis_in_world()
        velocity, self._out_of_reach = self.injector.velocity(wanted, axis, controller.insertion_m, period_s, self.now_ns)
        return velocity

    def _status(self, controller: RcmController) -> RcmStatus:
        limited = self._out_of_reach and controller.last_status is RcmStatus.TRACKING
        return RcmStatus.LIMITED if limited else controller.last_status

    def _capture_if_due(self) -> None:
        now_ns = self.now_ns
        if now_ns % self.config.camera_ns or self._renderer is None:
            return
        # Waiting and recording cost most when frames come, so that a sample of them is a whole camera period.
        self.timer.complete("record")
        self.timer.complete(WAIT)
        with self.timer.measure("capture"):
            true_pose = self.theatre.world_from_camera()
            captured = CapturedFrame(
                index=self.frame_count,
                captured_ns=now_ns,
                available_ns=self._transfer.arrival_ns(now_ns),
                world_from_camera=self.scope.world_from_camera(),
                true_pose=true_pose,
                view=self._renderer.take(self.theatre.data, true_pose),
                time_stamp_offset_ns=self.timing.time_stamp_offset_ns,
            )
            # The first frame is always looked at: its geometry at once, and then its image, where that will be needed too.
            first = self.first_captured is None
            if self._images_ahead or (first and self._running_server().begins_images):
                if first and not captured.view.whole.begun:
                    captured.view.only_geometry.begin()
                captured.view.whole.begin()
        self.timer.complete("capture")
        self.frame_count += 1
        self.newest_captured = captured
        self.timing_log.capture(captured.times)
        self._transfer.send(captured)
        if self.first_captured is None:
            # Its target is still to be chosen.
            self.first_captured = captured
        else:
            self._mark(captured)
        if self.recorder.takes_frames:
            truth, frame = captured.truth, captured.frame
            with self.timer.measure("record"):
                self.recorder.frame(
                    FrameRecord(now_ns=now_ns, frame=frame, exact_depth_mm=truth.depth_mm, object_id=truth.object_id)
                )

    def _hand_over(self) -> PerceptionServer:
        """Give perception the frames that have arrived."""
        server = self._running_server()
        for captured in self._transfer.arrived(self.now_ns):
            server.submit(captured)
        return server

    def _deliver(self) -> list[ServedFrame]:
        now_ns = self.now_ns
        finished = self._hand_over().poll(now_ns)
        arriving = self.injector.depth_frames(finished, self.rig.camera, now_ns)
        for one in finished:
            # Unless it is among those that arrive.
            self.timing_log.drop(one.captured.times, "withheld")
        served: list[ServedFrame] = []
        for one in arriving:
            self.timing_log.deliver(one.captured.times, one.available_ns)
            if self.newest_served is not None and one.captured_ns <= self.newest_served.captured_ns:
                self.timing_log.drop(one.captured.times, "overtaken")
                continue
            served.append(one)
            self.newest_served = one
            if self.recorder.takes_depth:
                # Waiting for image and depth map is not the recorder's time.
                _ = one.captured.truth, one.depth
                with self.timer.measure("record"):
                    self.recorder.depth(one.record(now_ns))
        return served

    def _mark(self, captured: CapturedFrame | None) -> None:
        """Remember where the target is in a frame that was captured just now."""
        if captured is not None and self._locate_target is not None:
            captured.mark(self._locate_target())
