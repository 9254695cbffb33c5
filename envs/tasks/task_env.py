"""What all tasks have in common behind Gymnasium's interface."""

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar, Generic, TypeVar, cast

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from laploop.arrays import Array
from laploop.assets.shafts import INSTRUMENT
from laploop.control.messages import ControlInput, TipController
from laploop.envs.loop.closed_loop import ClosedLoop
from laploop.envs.loop.perception_server import ServedFrame
from laploop.envs.recording.recorder import Recorder
from laploop.envs.sensors.stripe_capture import ExactView
from laploop.envs.tasks.actions import ActionInterpreter, action_space, checked_action
from laploop.envs.tasks.observations import (
    MAX_FORCE_N,
    Observation,
    bounded,
    depth_observation,
    depth_quality,
    observation_space,
)
from laploop.envs.tasks.registry import task_spec
from laploop.envs.tasks.reset_arguments import check_reset
from laploop.envs.tasks.savable_env import SavableEnv
from laploop.envs.tasks.steppable_env import Begin, Info, Step
from laploop.envs.tasks.surface_point import SurfacePoint
from laploop.envs.tasks.target_choice import checked_pixels, choose_target_pixel
from laploop.envs.tasks.task_config import DEPTH_MODES, STRIPE_MODES, TaskConfig
from laploop.envs.tasks.tick_record import tick_record
from laploop.envs.theatre.physics_call import PhysicsRun
from laploop.errors import InvalidValueError, SimulationError
from laploop.perception.estimators.base import DepthEstimator
from laploop.perception.estimators.chosen import chosen_estimator
from laploop.perception.geometry import Rig, invert_transform, transform_points

ConfigT = TypeVar("ConfigT", bound=TaskConfig)

HARMS = ("force", "rcm")
"""Values of `terminated_by` for an exceeded safety limit."""


class TaskEnv(SavableEnv, Generic[ConfigT]):
    """A task in the closed loop; one step is one control period, 8 ms by default.

    The target is a material point of the tissue: the one that the chosen pixel showed when the first frame was captured. An
    episode starts when the first depth map has arrived, so that there is always one.

    A task defines how its target is chosen, what it measures at every control tick, its own reward terms, and when it is over.
    Everything else is here, in one order: action, loop, measurement, end, reward, record. Actions and observations:
    `laploop.envs.tasks.actions` and `laploop.envs.tasks.observations`.

    Every task terminates with `terminated_by` = `force` when the tip was pressed harder than `harm_force_n`, with `rcm` when a
    shaft is farther than `harm_rcm_m` off its trocar; it is truncated with `time` after `max_seconds`.

    `info` holds `target_error_mm`, `rcm_error_mm` (`camera`, `tool`: worst of the period's physics steps), `port_force_n` and
    `port_friction_n` (likewise, of the trocar's wall and seal), `contact_force_n` (likewise), `depth_mae_mm` and
    `depth_valid_fraction` (both on the tissue; None while nobody uses depth maps: neither observations, the mode `residual`,
    recorder nor a call of `control_input`), `depth_jump_fraction` (of the target's surroundings, what a controller within the
    environment rejects, since its depth jumped; None without one), `depth_age_ms`, `sim_s`, `frames`, `dropped_frames`,
    `frame_times` (`FrameTimes` of the newest frame that a control tick knew, or None), `status` and `status_reason` (of the
    inverse kinematics), `fault` (why the command was not followed, or None), `injected_faults`, `assessed`, `success`,
    `terminated_by`, `reward_terms`.
    """

    metadata = {"render_modes": []}  # noqa: RUF012  Gymnasium's own convention

    config_type: ClassVar[type[TaskConfig]]
    """The task's configuration."""
    reset_options: ClassVar[tuple[str, ...]] = ("target_pixel",)
    """What `reset` takes in its options."""
    moves_scope: ClassVar[bool] = False
    """Whether actions move the camera arm in place of the tool arm."""

    def __init__(
        self,
        config: ConfigT | None = None,
        perception: str | DepthEstimator = "compact",
        recorder: Recorder | None = None,
        controller: TipController | None = None,
    ) -> None:
        """Make the environment.

        Args:
            config: The task, its loop and its theatre; by default the task's own.
            perception: Name of a registered estimator, or an object with `estimate`.
            recorder: Receives everything that happens.
            controller: What the action mode `residual` adds to, in place of the task's scripted controller.

        Raises:
            UnknownNameError: If no estimator has that name.
            InvalidValueError: If the configuration is another task's, or the estimator has no `estimate`.
        """
        if config is not None and not isinstance(config, self.config_type):
            raise InvalidValueError("config", type(config).__name__, f"a {self.config_type.__name__}")
        self.config: ConfigT = config or cast("Any", self.config_type)()
        self.perception = perception
        scope = self.config.loop.theatre.scope
        mode = self.config.observation_mode
        hides = any(fault.kind == "target-hidden" for fault in self.config.loop.faults)
        self.loop = ClosedLoop(
            self.config.loop,
            chosen_estimator(perception, Rig.from_optics(scope)),
            recorder,
            moves_scope=self.moves_scope,
            locate_target=self.target_in_world if self.config.marker or hides else None,
            images=mode in STRIPE_MODES,
            depth=mode in DEPTH_MODES or self.config.action_mode == "residual",
        )
        if self.config.action_mode == "residual" and controller is None:
            from laploop.control.controllers.registry import make_controller

            controller = make_controller(task_spec(self.task).controller, self.loop.rig)
        self._interpreter = ActionInterpreter(self.config, self.loop, controller, yields=not self.moves_scope)
        self.action_space = action_space(self.config)
        self.observation_space = observation_space(mode, (scope.height, scope.width), self.extra_spaces())
        self._running = False
        self._target: SurfacePoint | None = None
        self._touched: tuple[int, SurfacePoint, Array, Array] | None = None  # time, target, its normal and place then
        self.target_pixel = np.full(2, np.nan)
        self._measured: tuple[ServedFrame, bool] | None = None
        self._depth_mae_mm: float | None = None
        self._depth_valid_fraction: float | None = None

    def _make_anew(self, config: Any, perception: str | DepthEstimator) -> None:
        TaskEnv.__init__(self, config, perception)

    @property
    def task(self) -> str:
        """The task's name."""
        return self.config.kind

    @property
    def action_check(self) -> Callable[[object], Array]:
        """See `SteppableEnv`."""
        return partial(checked_action, config=self.config)

    def share_cores(self) -> None:
        """See `SteppableEnv`."""
        self.loop.observed.threads = 1

    # What a task defines.

    def extra_spaces(self) -> dict[str, spaces.Box]:
        """Return the spaces of the task's own observations."""
        return {}

    def extra_observation(self) -> Observation:
        """Return the task's own observations."""
        return {}

    def choose_target(self, rng: np.random.Generator, options: Mapping[str, Any]) -> None:
        """Choose the target in the first frame: a pixel of `options`, or one drawn from those that qualify."""
        camera = self.loop.rig.camera
        if "target_pixel" in options:
            column, row = checked_pixels("target_pixel", options["target_pixel"], camera)[0].astype(int).tolist()
        else:
            column, row = choose_target_pixel(self.first_view(), camera, self.trocar_in_camera(), rng, self.config.target)
        self.set_target(self.surface_point(column, row), np.array([column + 0.5, row + 0.5]))

    @abstractmethod
    def measure(self, *, begin: bool) -> None:
        """Measure what the task is about, at the begin of an episode and after every control period."""

    def target_error_mm(self) -> float:
        """Return the distance of the moved tip from where it should be: by default, from an ideal touch of the target."""
        return self.touch_error_mm()

    def ended_by(self) -> str | None:
        """Return why the task is over, `success` if it is solved, or None while it is not."""
        return None

    def solved_in_time(self) -> bool:
        """Return whether a task of fixed duration is solved when its time is over."""
        return False

    @abstractmethod
    def reward_terms(self) -> dict[str, float]:
        """Return the task's own terms of one control period, unweighted, without those that all tasks share."""

    def task_info(self) -> Info:
        """Return the task's own part of `info`."""
        return {}

    def assessed(self, infos: Sequence[Info]) -> Sequence[Info]:
        """Return the ticks of an episode by which its accuracy is judged; all of them if none was assessed."""
        counted = [info for info in infos if info["assessed"]]
        return counted or infos

    def metrics(self) -> dict[str, float | None]:
        """Return the task's own results of the episode so far, by name with unit; None for what could not be measured."""
        return {}

    # What all tasks share.

    def resetting(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> PhysicsRun[Begin]:
        """Build a tissue, start the loop, choose a target: in the first frame, at time 0, before the loop runs."""
        check_reset(seed, options, self.reset_options)
        self.seed_generator(seed)
        self._running = False
        theatre_rng, target_rng = self.np_random.spawn(2)
        theatre_seed = int(theatre_rng.integers(2**31)) if seed is None else int(seed)
        self._interpreter.reset()
        self._target = self._touched = None
        choose = partial(self.choose_target, target_rng, options or {})
        yield from self.loop.resetting(theatre_rng, theatre_seed=theatre_seed, at_first_frame=choose)
        self.measure(begin=True)
        self._running = True
        info = self._info(reward_terms={}, terminated_by=None, succeeded=False)
        return self.observation(), info

    def stepping(self, action: NDArray[np.floating[Any]]) -> PhysicsRun[Step]:
        """Run one control period, and observe."""
        reward, terminated, truncated, info = yield from self.ticking(action)
        return self.observation(), reward, terminated, truncated, info

    def ticking(self, action: NDArray[np.floating[Any]]) -> PhysicsRun[tuple[float, bool, bool, Info]]:
        """Run one control period without observing, for whoever looks only after several of them."""
        if not self._running:
            raise SimulationError("the episode has ended or not begun; call reset() first")
        checked = checked_action(action, self.config)
        # An error from here on, such as an estimator's, leaves an episode that cannot continue.
        self._running = False
        velocity = self._interpreter.velocity(checked, self.control_input)
        if self.moves_scope:
            yield from self.loop.advancing(np.zeros(3), velocity)
        else:
            yield from self.loop.advancing(velocity)
        self.measure(begin=False)
        terminated_by = self._harm() or self.ended_by()
        truncated = terminated_by is None and self.loop.now_ns >= round(self.config.max_seconds * 1e9)
        succeeded = self.solved_in_time() if truncated else terminated_by == "success"
        shared_terms = {
            "force": -max(0.0, self.loop.max_force_n - self.config.alarm_force_n),
            "effort": -((float(np.linalg.norm(velocity)) / self.config.max_tip_speed_mps) ** 2),
            "success": float(succeeded),
            "harm": -float(terminated_by in HARMS),
        }
        weights, unweighted = vars(self.config.rewards), {**self.reward_terms(), **shared_terms}
        terms = {name: value * float(weights[name]) for name, value in unweighted.items()}
        info = self._info(terms, "time" if truncated else terminated_by, succeeded=succeeded)
        self._record_tick(info, velocity)
        self._running = terminated_by is None and not truncated
        return float(sum(terms.values())), terminated_by is not None, truncated, info

    def observation(self) -> Observation:
        """Return what can be observed now."""
        mode, served, newest = self.config.observation_mode, self.loop.newest_served, self.loop.newest_arrived
        if served is None or newest is None:
            raise SimulationError("no frame yet")
        tip, velocity, force = self.loop.reading().seen_from(invert_transform(self.loop.scope.world_from_camera()))
        observation: Observation = {"stripes": newest.frame.image.copy()} if mode in STRIPE_MODES else {}
        if mode in DEPTH_MODES:
            observation |= depth_observation(served, self.loop.now_ns)
        observation["tip_position"] = bounded(tip, -1.0, 1.0)
        observation["tip_velocity"] = bounded(velocity, -1.0, 1.0)
        observation["contact_force"] = bounded(force, -MAX_FORCE_N, MAX_FORCE_N)
        observation["target_pixel"] = self.target_pixel.astype(np.float32)
        if mode == "state":
            camera_from_world = invert_transform(self.loop.theatre.world_from_camera())
            _, normal, position = self.target_offset()
            observation["target_position"] = bounded(transform_points(camera_from_world, position), -1.0, 1.0)
            observation["target_normal"] = bounded(camera_from_world[:3, :3] @ normal, -1.0, 1.0)
        return observation | self.extra_observation()

    def close(self) -> None:
        """End the perception thread."""
        self._running = False
        self.loop.close()

    def control_input(self) -> ControlInput:
        """Return everything that a tip controller may know now; `laploop.control.messages.TipController` takes it."""
        known = self.loop.control_input(self.target_pixel)
        return known if self.config.marker else replace(known, marker_pixel=None)

    def target_in_world(self) -> Array:
        """Return where the material target point is now, (3,), metres."""
        return self.surface_target().position(self.loop.theatre.tissue)

    def surface_target(self) -> SurfacePoint:
        """Return the target as a point of the tissue.

        Raises:
            SimulationError: If there is none yet.
        """
        if self._target is None:
            raise SimulationError("there is no target yet; call reset() first")
        return self._target

    # For the tasks.

    def first_view(self) -> ExactView:
        """Return the exact geometry of the first frame.

        Raises:
            SimulationError: If there is none yet.
        """
        if self.loop.first_captured is None:
            raise SimulationError("the first frame is missing")
        return self.loop.first_captured.geometry

    def set_target(self, target: SurfacePoint, pixel: Array) -> None:
        """Set the target and the pixel (2,) of the first frame that shows it."""
        self._target = target
        self.target_pixel = pixel

    def surface_point(self, column: float, row: float) -> SurfacePoint:
        """Return the point of the tissue that the centre of a pixel shows now."""
        world_from_camera = self.loop.theatre.world_from_camera()
        direction = world_from_camera[:3, :3] @ self.loop.rig.camera.rays[int(row), int(column)]
        tissue = self.loop.theatre.tissue
        return SurfacePoint.from_ray(tissue.surface_points(), tissue.triangles, world_from_camera[:3, 3], direction)

    def trocar_in_camera(self) -> Array:
        """Return where the tool's shaft passes the wall, (3,), in the camera's frame."""
        theatre = self.loop.theatre
        return transform_points(invert_transform(theatre.world_from_camera()), theatre.tool_arm.trocar_in_world)

    def target_offset(self) -> tuple[Array, Array, Array]:
        """Return the vector from the target to the tool's tip, the target's normal, and the target, each (3,), in the world."""
        now_ns, target, tissue = self.loop.now_ns, self.surface_target(), self.loop.theatre.tissue
        if self._touched is None or self._touched[:2] != (now_ns, target):
            self._touched = now_ns, target, target.normal(tissue), target.position(tissue)
        _, _, normal, position = self._touched
        return self.loop.theatre.tip_in_world() - position, normal, position

    def touch_error_mm(self) -> float:
        """Return the distance of the tool's tip from an ideal touch: one ball radius above the target along its normal."""
        offset, normal, _ = self.target_offset()
        return float(np.linalg.norm(offset - INSTRUMENT.tip_radius_m * normal)) * 1e3

    def is_assessed(self) -> bool:
        """Return whether this tick counts for the task's accuracy."""
        return True

    def _harm(self) -> str | None:
        if self.loop.max_force_n > self.config.harm_force_n:
            return "force"
        if max(self.loop.max_rcm_error_m.values()) > self.config.harm_rcm_m:
            return "rcm"
        return None

    def _info(self, reward_terms: dict[str, float], terminated_by: str | None, *, succeeded: bool) -> Info:
        if (served := self.loop.newest_served) is None:
            raise SimulationError("no depth frame yet")
        used = self.loop.depth_is_used
        if self._measured != (served, used):
            self._measured = served, used
            self._depth_mae_mm, self._depth_valid_fraction = depth_quality(served) if used else (None, None)
        status = self.loop.scope_status or self.loop.tool_status
        return {
            **self.task_info(),
            "rcm_error_mm": {name: error * 1e3 for name, error in self.loop.max_rcm_error_m.items()},
            "port_force_n": dict(self.loop.max_port_force_n),
            "port_friction_n": dict(self.loop.max_port_friction_n),
            "contact_force_n": self.loop.max_force_n,
            "depth_mae_mm": self._depth_mae_mm,
            "depth_valid_fraction": self._depth_valid_fraction,
            "depth_jump_fraction": self._interpreter.depth_jump_fraction,
            "depth_age_ms": served.age_ns(self.loop.now_ns) * 1e-6,
            "sim_s": self.loop.now_ns * 1e-9,
            "frames": self.loop.frame_count,
            "dropped_frames": self.loop.dropped_frames,
            "frame_times": None if (newest := self.loop.timing_log.newest_used) is None else dict(vars(newest)),
            "status": str(status),
            "status_reason": self.loop.status_reason,
            "fault": self._interpreter.fault,
            "injected_faults": self.loop.injector.active(self.loop.now_ns),
            "assessed": self.is_assessed(),
            "success": succeeded,
            "terminated_by": terminated_by,
            "reward_terms": reward_terms,
        }

    def _record_tick(self, info: Info, command: Array) -> None:
        recorder = self.loop.recorder
        if recorder.takes_ticks:
            with self.loop.timer.measure("record"):
                recorder.tick(tick_record(self, info, command))
