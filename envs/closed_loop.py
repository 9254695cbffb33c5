"""Everything between a desired tip velocity and the next depth frame: physics, stripes, perception, trocar-aware control."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.shafts import INSTRUMENT
from laploop.control.messages import ControlInput
from laploop.control.rcm_controller import RcmController, RcmControllerConfig
from laploop.control.robot import ArmModel
from laploop.envs.clock_rates import ClockRates
from laploop.envs.latency import ConstantLatency, LatencyModel
from laploop.envs.perception_server import CapturedFrame, PerceptionServer, ServedFrame
from laploop.envs.proprioception import Proprioception, ProprioceptionConfig, ProprioceptiveReading
from laploop.envs.recorder import DepthRecord, FrameRecord, NullRecorder, Recorder
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.envs.sensors.stripe_optics import StripeOptics
from laploop.envs.stage_timer import StageTimer
from laploop.envs.theatre import Theatre
from laploop.envs.theatre_config import TheatreConfig
from laploop.errors import InvalidValueError, SimulationError
from laploop.perception.estimators.base import DepthEstimator
from laploop.perception.geometry import Rig, invert_transform, transform_points
from laploop.perception.messages import StripeFrame

Array = NDArray[np.float64]

MAX_WAIT_NS = 10_000_000_000
"""How long a reset waits for the first depth frame."""


@dataclass(frozen=True, kw_only=True)
class LoopConfig:
    """The stages of the loop and their timing."""

    rates: ClockRates = field(default_factory=ClockRates)
    latency: LatencyModel = field(default_factory=ConstantLatency)
    """Service time of the perception stage."""
    transfer_ns: int = 0
    """From the capture of a frame to its arrival at the perception stage."""
    scope: ScopeOptics = field(default_factory=ScopeOptics)
    stripes: StripeOptics = field(default_factory=StripeOptics)
    proprioception: ProprioceptionConfig = field(default_factory=ProprioceptionConfig)
    rcm: RcmControllerConfig = field(default_factory=RcmControllerConfig)
    device: str = "cpu"
    """Where stripes are rendered: `cpu` or a CUDA device."""

    def __post_init__(self) -> None:
        """Check the transfer time.

        Raises:
            InvalidValueError: If it is negative.
        """
        if self.transfer_ns < 0:
            raise InvalidValueError("transfer_ns", self.transfer_ns, "0 or more")


class ClosedLoop:
    """A theatre with its sensor, its perception stage and its arm controller, under one clock.

    In every physics step the order is: physics, kinematics refreshed, proprioception, capture if a camera period begins,
    arrival of depth frames. In every control period the joint references come first.
    """

    def __init__(self, config: LoopConfig, estimator: DepthEstimator, recorder: Recorder | None = None) -> None:
        """Keep the parts that outlive an episode; `reset` makes the rest."""
        self.config = config
        self.estimator = estimator
        self.recorder: Recorder = recorder or NullRecorder()
        self.rig = Rig.from_optics(config.scope)
        self.timer = StageTimer()
        self._server: PerceptionServer | None = None

    def reset(
        self, theatre_config: TheatreConfig, rng: np.random.Generator, at_first_frame: Callable[[], None] | None = None
    ) -> None:
        """Build the theatre and run it, arms held, until the first depth frame has arrived.

        Args:
            theatre_config: What to build; its time step and control period must be those of the rates.
            rng: Source of noise, of latencies, of the tissue's texture, and of the proprioceptive channels' corruption.
            at_first_frame: Called at time 0, when the first frame has just been captured.

        Raises:
            InvalidValueError: If the theatre's time step or control period is not that of the rates.
            SimulationError: If no depth frame arrives.
        """
        rates = self.config.rates
        for name, period_ns in (("timestep_s", rates.physics_ns), ("control_period_s", rates.control_ns)):
            if round(getattr(theatre_config, name) * 1e9) != period_ns:
                raise InvalidValueError(name, getattr(theatre_config, name), f"{period_ns * 1e-9} as in the rates")
        self.close()
        self._noise_rng, latency_rng, corruption_rng, texture_rng = rng.spawn(4)
        self.timer = StageTimer()
        self.theatre = Theatre(theatre_config)
        self.theatre.reset()
        arm = self.theatre.tool_arm
        self._tool_controller = RcmController(ArmModel(arm.world_from_base, INSTRUMENT), arm.trocar_in_world, self.config.rcm)
        self._tool_controller.reset(arm.home_q)
        self._camera = StripeCamera(self.rig, self.config.stripes, device=self.config.device)
        self._camera.attach(self.theatre.model, rng=texture_rng)
        self._server = PerceptionServer(self.estimator, self.config.latency, latency_rng)
        self._proprioception = Proprioception(
            self.theatre, self.config.proprioception, self.config.rates.physics_steps_per_control
        )
        self._proprioception.reset(np.random.RandomState(corruption_rng.integers(2**32)))
        self.frame_count = 0
        self.max_rcm_error_m = {"camera": 0.0, "tool": 0.0}
        self.max_force_n = 0.0
        self.first_captured: CapturedFrame | None = None
        self.newest_captured: CapturedFrame | None = None
        self.newest_served: ServedFrame | None = None
        self._in_transfer: list[CapturedFrame] = []
        self.recorder.begin(self.theatre, self.rig)
        self._capture_if_due()
        if at_first_frame is not None:
            at_first_frame()
        self._deliver()
        while self.newest_served is None:
            if self.now_ns > MAX_WAIT_NS:
                raise SimulationError(f"no depth frame arrived within {MAX_WAIT_NS * 1e-9:.0f} s of simulated time")
            self.advance(np.zeros(3))

    def advance(self, tip_velocity_in_camera: Array) -> list[ServedFrame]:
        """Run one control period.

        Args:
            tip_velocity_in_camera: (3,), desired velocity of the tip in m/s, along the camera's axes.

        Returns:
            The depth frames that arrived, oldest first.
        """
        rates = self.config.rates
        with self.timer.measure("control"):
            rotation = self.theatre.world_from_camera()[:3, :3]
            q, qdot = self._tool_controller.step(rotation @ tip_velocity_in_camera, rates.control_s)
        self.timer.complete("control")
        self.theatre.set_joint_targets(self.theatre.tool_arm, q, qdot)
        self._proprioception.before_control_period()
        self.max_rcm_error_m = {"camera": 0.0, "tool": 0.0}
        self.max_force_n = 0.0
        served: list[ServedFrame] = []
        for remaining in reversed(range(rates.physics_steps_per_control)):
            with self.timer.measure("physics"):
                self.theatre.step()
                # MuJoCo leaves poses one step old; whoever looks at them gets fresh ones.
                if remaining == 0 or self.now_ns % rates.camera_ns == 0:
                    self.theatre.refresh()
            self.timer.complete("physics")
            self._proprioception.after_physics_step()
            for name, arm in (("camera", self.theatre.camera_arm), ("tool", self.theatre.tool_arm)):
                self.max_rcm_error_m[name] = max(self.max_rcm_error_m[name], self.theatre.rcm_error_m(arm))
            force = float(np.linalg.norm(self.theatre.contact_force_in_world()))
            self.max_force_n = max(self.max_force_n, force)
            self._capture_if_due()
            served += self._deliver()
        return served

    @property
    def now_ns(self) -> int:
        """Simulated time."""
        return self.theatre.now_ns

    @property
    def dropped_frames(self) -> int:
        """Frames that a newer one overtook before perception had time for them."""
        return self._server.dropped if self._server is not None else 0

    def reading(self) -> ProprioceptiveReading:
        """Return what the tool arm's own channels deliver now."""
        return self._proprioception.read()

    def control_input(self, target_pixel: Array) -> ControlInput:
        """Gather all that a tip controller may know."""
        camera_from_world = invert_transform(self.theatre.world_from_camera())
        reading = self.reading()
        return ControlInput(
            now_ns=self.now_ns,
            depth=self.newest_served.depth if self.newest_served else None,
            target_pixel=target_pixel,
            tip_in_camera=transform_points(camera_from_world, reading.tip_in_world),
            tip_velocity_in_camera=camera_from_world[:3, :3] @ reading.tip_velocity_in_world,
            trocar_in_camera=transform_points(camera_from_world, self.theatre.tool_arm.trocar_in_world),
            contact_force_n=float(np.linalg.norm(reading.contact_force_in_world)),
        )

    def close(self) -> None:
        """End the perception thread of the running episode, if any."""
        if self._server is not None:
            self._server.close()
            self._server = None

    def _capture_if_due(self) -> None:
        now_ns = self.now_ns
        if now_ns % self.config.rates.camera_ns:
            return
        # Recording costs most when frames come, so that a sample of it is a whole camera period.
        self.timer.complete("record")
        with self.timer.measure("render"):
            world_from_camera = self.theatre.world_from_camera()
            truth = self._camera.capture(self.theatre.data, world_from_camera, self._noise_rng)
        self.timer.complete("render")
        frame = StripeFrame(
            index=self.frame_count,
            image=truth.image,
            captured_ns=now_ns,
            available_ns=now_ns + self.config.transfer_ns,
            world_from_camera=world_from_camera,
        )
        self.frame_count += 1
        captured = CapturedFrame(frame=frame, truth=truth)
        self.first_captured = self.first_captured or captured
        self.newest_captured = captured
        self._in_transfer.append(captured)
        with self.timer.measure("record"):
            self.recorder.frame(
                FrameRecord(now_ns=now_ns, frame=frame, exact_depth_mm=truth.depth_mm, object_id=truth.object_id)
            )

    def _deliver(self) -> list[ServedFrame]:
        if self._server is None:
            raise InvalidValueError("loop", "closed", "a loop that was reset")
        now_ns = self.now_ns
        while self._in_transfer and self._in_transfer[0].frame.available_ns <= now_ns:
            self._server.submit(self._in_transfer.pop(0))
        served = self._server.poll(now_ns)
        for one in served:
            self.newest_served = one
            if self._server.last_compute_s is not None:
                self.timer.add("perception", self._server.last_compute_s)
            truth = one.captured.truth
            with self.timer.measure("record"):
                self.recorder.depth(
                    DepthRecord(
                        now_ns=now_ns,
                        depth=one.depth,
                        stripes=one.captured.frame.image,
                        exact_depth_mm=truth.depth_mm,
                        tissue=truth.object_id == ObjectId.TISSUE,
                    )
                )
        return served
