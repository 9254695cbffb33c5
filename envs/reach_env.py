"""The reach task behind Gymnasium's interface."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from laploop.assets.phantom import TissueConfig
from laploop.assets.shafts import INSTRUMENT
from laploop.control.messages import ControlInput
from laploop.envs.base_motion import BaseMotion
from laploop.envs.closed_loop import ClosedLoop, LoopConfig
from laploop.envs.perception_server import ServedFrame
from laploop.envs.reach_rewards import ReachRewardWeights, reach_reward_terms, weighted
from laploop.envs.recorder import Recorder, TickRecord
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.surface_point import SurfacePoint
from laploop.envs.target_choice import TargetChoiceConfig, choose_target_pixel
from laploop.envs.theatre_config import TheatreConfig
from laploop.errors import InvalidValueError, SimulationError
from laploop.perception.estimators.base import DepthEstimator
from laploop.perception.estimators.registry import make_estimator
from laploop.perception.geometry import Rig, invert_transform, transform_points

Array = NDArray[np.float64]
Observation = dict[str, Any]

MAX_DEPTH_MM = 250.0
"""Largest depth that an observation shows."""
MAX_AGE_S = 10.0
MAX_FORCE_N = 50.0


@dataclass(frozen=True, kw_only=True)
class ReachConfig:
    """What the reach task asks, and in which theatre."""

    motion: BaseMotion = field(default_factory=BaseMotion)
    loop: LoopConfig = field(default_factory=LoopConfig)
    target: TargetChoiceConfig = field(default_factory=TargetChoiceConfig)
    rewards: ReachRewardWeights = field(default_factory=ReachRewardWeights)
    tissue: TissueConfig = field(default_factory=TissueConfig)
    tissue_seed: int | None = None
    """Seed of the tissue; None takes the seed of `reset`, and draws a new one where that is None too."""
    max_seconds: float = 10.0
    """Simulated time after which an episode is truncated."""
    max_tip_speed: float = 0.06
    """Bound of each component of the action, in m/s."""
    success_radius_m: float = 0.0015
    success_hold_s: float = 0.3
    alarm_force_n: float = 2.0
    """Force from which the reward punishes pressing; below every tissue-damage threshold found for a small probe."""
    harm_force_n: float = 5.0
    harm_rcm_m: float = 0.005

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            InvalidValueError: If a value is not positive.
        """
        for name in (
            "max_seconds",
            "max_tip_speed",
            "success_radius_m",
            "success_hold_s",
            "alarm_force_n",
            "harm_force_n",
            "harm_rcm_m",
        ):
            if not getattr(self, name) > 0.0:
                raise InvalidValueError(name, getattr(self, name), "above 0")


class ReachEnv(gym.Env[dict[str, Any], NDArray[np.float32]]):
    """Bring the tip of the instrument onto a point of the tissue that was chosen in the first frame.

    One step is one control period (8 ms by default). The target is a material point: the one that the chosen pixel showed
    when the first frame was captured. A touch is ideal when the tip, the centre of the probe's ball end, lies one ball
    radius above that point along the surface's normal; the distance from there is the target error.

    ## Action

    `Box(-0.06, 0.06, (3,), float32)`: desired velocity of the tip in m/s along the camera's axes (x right, y down, z away
    from the camera). Larger values are clipped. The controller below holds the shaft in its trocar.

    ## Observation

    | key | space | meaning |
    |---|---|---|
    | `stripes` | `Box(0, 255, (256, 256), uint8)` | newest image of the stripe camera |
    | `depth_mm` | `Box(0, 250, (256, 256), float32)` | newest depth map that has arrived; 0 where it is not valid |
    | `depth_valid` | `Box(0, 1, (256, 256), uint8)` | where the estimator stands by its value |
    | `depth_age_s` | `Box(0, 10, (1,), float32)` | time since that map's frame was captured |
    | `tip_position` | `Box(-1, 1, (3,), float32)` | tip in the camera's frame, m |
    | `tip_velocity` | `Box(-1, 1, (3,), float32)` | its velocity, m/s |
    | `contact_force` | `Box(-50, 50, (3,), float32)` | force on the tip along the camera's axes, N |
    | `target_pixel` | `Box(0, 256, (2,), float32)` | chosen pixel (u, v) of the first frame, centres at +0.5 |

    An episode starts when the first depth map has arrived, so that there is always one.

    ## Reward

    Sum of the named terms in `info["reward_terms"]`: `distance`, `progress`, `contact`, `force`, `effort`, `success`,
    `harm` (`ReachRewardWeights`).

    ## End

    Terminated with `terminated_by` = `success` once the error has stayed below 1.5 mm for 0.3 s; with `force` above 5 N;
    with `rcm` when a shaft is more than 5 mm off its trocar. Truncated with `time` after `max_seconds`.

    ## Info

    `target_error_mm`, `rcm_error_mm` (`camera`, `tool`: worst of the period's physics steps), `contact_force_n` (likewise),
    `depth_mae_mm` and `depth_valid_fraction` (both on the tissue), `depth_age_ms`, `sim_s`, `frames`, `dropped_frames`,
    `success`, `terminated_by`, `reward_terms`.
    """

    metadata = {"render_modes": []}  # noqa: RUF012  Gymnasium's own convention

    def __init__(
        self,
        config: ReachConfig | None = None,
        perception: str | DepthEstimator = "compact",
        recorder: Recorder | None = None,
    ) -> None:
        """Make the environment.

        Args:
            config: What is asked and where.
            perception: Name of a registered estimator, or an object with `estimate`.
            recorder: Told everything that happens.

        Raises:
            UnknownNameError: If no estimator has that name.
        """
        self.config = config or ReachConfig()
        scope = self.config.loop.scope
        estimator = make_estimator(perception, Rig.from_optics(scope)) if isinstance(perception, str) else perception
        self.loop = ClosedLoop(self.config.loop, estimator, recorder)
        size = (scope.height, scope.width)
        speed = self.config.max_tip_speed
        self.action_space = spaces.Box(-speed, speed, (3,), np.float32)
        self.observation_space = spaces.Dict(
            {
                "stripes": spaces.Box(0, 255, size, np.uint8),
                "depth_mm": spaces.Box(0.0, MAX_DEPTH_MM, size, np.float32),
                "depth_valid": spaces.Box(0, 1, size, np.uint8),
                "depth_age_s": spaces.Box(0.0, MAX_AGE_S, (1,), np.float32),
                "tip_position": spaces.Box(-1.0, 1.0, (3,), np.float32),
                "tip_velocity": spaces.Box(-1.0, 1.0, (3,), np.float32),
                "contact_force": spaces.Box(-MAX_FORCE_N, MAX_FORCE_N, (3,), np.float32),
                "target_pixel": spaces.Box(0.0, float(max(size)), (2,), np.float32),
            }
        )
        self._running = False
        self._target: SurfacePoint | None = None
        self._measured: ServedFrame | None = None
        self._depth_mae_mm = self._depth_valid_fraction = float("nan")

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, dict[str, Any]]:
        """Build a tissue, start the loop, choose a target.

        Args:
            seed: Decides everything that is random in the episode.
            options: `{"target_pixel": (column, row)}` chooses the target by hand.

        Raises:
            InvalidValueError: If the chosen pixel shows no tissue.
        """
        super().reset(seed=seed)
        self._running = False
        theatre_rng, target_rng = self.np_random.spawn(2)
        tissue_seed = self.config.tissue_seed
        if tissue_seed is None:
            tissue_seed = int(theatre_rng.integers(2**31)) if seed is None else seed
        rates = self.config.loop.rates
        theatre_config = TheatreConfig(
            seed=tissue_seed,
            motion=self.config.motion,
            tissue=self.config.tissue,
            timestep_s=rates.physics_s,
            control_period_s=rates.control_s,
            optics=self.config.loop.scope,
        )
        # The target is a material point of the first frame, so its vertices are those at time 0, before the loop runs on.
        self._target = None
        self.loop.reset(theatre_config, theatre_rng, at_first_frame=lambda: self._choose_target(target_rng, options or {}))
        self._held_ns = 0
        self._error_mm = self.target_error_mm()
        self._running = True
        info = self._info(reward_terms={}, terminated_by=None)
        return self._observation(), info

    def step(self, action: NDArray[np.floating[Any]]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Run one control period.

        Raises:
            InvalidValueError: If the action has another shape or an entry that is not finite.
            SimulationError: If the episode has ended or not begun.
        """
        if not self._running:
            raise SimulationError("the episode has ended or not begun; call reset() first")
        velocity = np.asarray(action, dtype=np.float64)
        if velocity.shape != (3,) or not np.isfinite(velocity).all():
            raise InvalidValueError("action", np.asarray(action).tolist(), "3 finite numbers (m/s)")
        velocity = np.clip(velocity, -self.config.max_tip_speed, self.config.max_tip_speed)
        self.loop.advance(velocity)
        previous_error_mm, self._error_mm = self._error_mm, self.target_error_mm()
        terminated_by = self._termination()
        terms = weighted(
            reach_reward_terms(
                error_mm=self._error_mm,
                previous_error_mm=previous_error_mm,
                contact_force_n=self.loop.max_force_n,
                alarm_force_n=self.config.alarm_force_n,
                action_fraction=float(np.linalg.norm(velocity)) / self.config.max_tip_speed,
                succeeded=terminated_by == "success",
                harmed=terminated_by in {"force", "rcm"},
            ),
            self.config.rewards,
        )
        truncated = terminated_by is None and self.loop.now_ns >= round(self.config.max_seconds * 1e9)
        info = self._info(reward_terms=terms, terminated_by="time" if truncated else terminated_by)
        self._record_tick(info)
        self._running = terminated_by is None and not truncated
        return self._observation(), float(sum(terms.values())), terminated_by is not None, truncated, info

    def close(self) -> None:
        """End the perception thread."""
        self._running = False
        self.loop.close()

    def control_input(self) -> ControlInput:
        """Return all that a tip controller may know now; `laploop.control.messages.TipController` takes it."""
        return self.loop.control_input(self.target_pixel)

    def target_in_world(self) -> Array:
        """Return where the material target point is now, (3,), metres."""
        return self._surface_target().position(self.loop.theatre.tissue.surface_points())

    def target_error_mm(self) -> float:
        """Return the distance of the tip from an ideal touch of the target."""
        points = self.loop.theatre.tissue.surface_points()
        target = self._surface_target()
        ideal = target.position(points) + INSTRUMENT.tip_radius_m * target.normal(points)
        return float(np.linalg.norm(self.loop.theatre.tip_in_world() - ideal)) * 1e3

    def _surface_target(self) -> SurfacePoint:
        if self._target is None:
            raise SimulationError("there is no target yet; call reset() first")
        return self._target

    def _choose_target(self, rng: np.random.Generator, options: Mapping[str, Any]) -> None:
        theatre, camera = self.loop.theatre, self.loop.rig.camera
        captured = self.loop.first_captured
        if captured is None:
            raise SimulationError("the first frame is missing")
        world_from_camera = theatre.world_from_camera()
        if "target_pixel" in options:
            column, row = (int(value) for value in options["target_pixel"])
            if not (0 <= column < camera.width and 0 <= row < camera.height):
                raise InvalidValueError("target_pixel", (column, row), f"within {camera.width} x {camera.height} pixels")
        else:
            trocar_in_camera = transform_points(invert_transform(world_from_camera), theatre.tool_arm.trocar_in_world)
            column, row = choose_target_pixel(captured.truth, camera, trocar_in_camera, rng, self.config.target)
        self.target_pixel = np.array([column + 0.5, row + 0.5])
        direction = world_from_camera[:3, :3] @ camera.rays[row, column]
        tissue = theatre.tissue
        self._target = SurfacePoint.from_ray(tissue.surface_points(), tissue.triangles, world_from_camera[:3, 3], direction)

    def _termination(self) -> str | None:
        period_ns = self.config.loop.rates.control_ns
        self._held_ns = self._held_ns + period_ns if self._error_mm <= self.config.success_radius_m * 1e3 else 0
        if self.loop.max_force_n > self.config.harm_force_n:
            return "force"
        if max(self.loop.max_rcm_error_m.values()) > self.config.harm_rcm_m:
            return "rcm"
        if self._held_ns >= round(self.config.success_hold_s * 1e9):
            return "success"
        return None

    def _observation(self) -> Observation:
        served = self.loop.newest_served
        newest = self.loop.newest_captured
        if served is None or newest is None:
            raise SimulationError("no frame yet")
        known = self.control_input()
        rotation = self.loop.theatre.world_from_camera()[:3, :3]
        force = rotation.T @ self.loop.reading().contact_force_in_world
        estimate = served.depth.estimate
        depth_mm = np.where(estimate.valid, np.clip(estimate.depth_mm, 0.0, MAX_DEPTH_MM), np.float32(0.0))
        return {
            "stripes": newest.frame.image.copy(),
            "depth_mm": depth_mm,
            "depth_valid": estimate.valid.astype(np.uint8),
            "depth_age_s": _bounded([served.depth.age_ns(self.loop.now_ns) * 1e-9], 0.0, MAX_AGE_S),
            "tip_position": _bounded(known.tip_in_camera, -1.0, 1.0),
            "tip_velocity": _bounded(known.tip_velocity_in_camera, -1.0, 1.0),
            "contact_force": _bounded(force, -MAX_FORCE_N, MAX_FORCE_N),
            "target_pixel": self.target_pixel.astype(np.float32),
        }

    def _info(self, reward_terms: dict[str, float], terminated_by: str | None) -> dict[str, Any]:
        served = self.loop.newest_served
        if served is None:
            raise SimulationError("no depth frame yet")
        if served is not self._measured:
            self._measured = served
            self._depth_mae_mm, self._depth_valid_fraction = _depth_quality(served)
        return {
            "target_error_mm": self._error_mm,
            "rcm_error_mm": {name: error * 1e3 for name, error in self.loop.max_rcm_error_m.items()},
            "contact_force_n": self.loop.max_force_n,
            "depth_mae_mm": self._depth_mae_mm,
            "depth_valid_fraction": self._depth_valid_fraction,
            "depth_age_ms": served.depth.age_ns(self.loop.now_ns) * 1e-6,
            "sim_s": self.loop.now_ns * 1e-9,
            "frames": self.loop.frame_count,
            "dropped_frames": self.loop.dropped_frames,
            "success": terminated_by == "success",
            "terminated_by": terminated_by,
            "reward_terms": reward_terms,
        }

    def _record_tick(self, info: dict[str, Any]) -> None:
        with self.loop.timer.measure("record"):
            self.loop.recorder.tick(
                TickRecord(
                    now_ns=self.loop.now_ns,
                    target_error_mm=info["target_error_mm"],
                    target_in_world=self.target_in_world(),
                    rcm_error_mm=info["rcm_error_mm"],
                    contact_force_n=info["contact_force_n"],
                    depth_age_ms=info["depth_age_ms"],
                    stage_ms=self.loop.timer.lap_ms(),
                )
            )


def _depth_quality(served: ServedFrame) -> tuple[float, float]:
    """Return mean absolute error in mm and share of valid pixels, both on the tissue that the frame shows."""
    truth = served.captured.truth
    tissue = truth.object_id == ObjectId.TISSUE
    valid = tissue & served.depth.estimate.valid
    errors = np.abs(served.depth.estimate.depth_mm[valid] - truth.depth_mm[valid])
    mae_mm = float(errors.mean()) if errors.size else float("nan")
    return mae_mm, float(valid.sum() / max(1, tissue.sum()))


def _bounded(values: Any, low: float, high: float) -> NDArray[np.float32]:
    return np.clip(np.asarray(values, dtype=np.float32), np.float32(low), np.float32(high))
