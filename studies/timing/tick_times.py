"""How long control ticks over breathing tissue take: in the loop, and alone on a core."""

import time
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from laploop.assets.shafts import INSTRUMENT, Shaft
from laploop.control.arm.model import ArmModel
from laploop.control.arm.rcm_controller import RcmController
from laploop.control.controllers.track import TrackController
from laploop.control.messages import ControlInput
from laploop.control.prediction.motion_predictor import Prediction
from laploop.control.prediction.rhythm_predictor import RhythmPredictor
from laploop.envs.loop.config import LoopConfig
from laploop.envs.tasks.configs import TrackConfig
from laploop.envs.tasks.task_env import TaskEnv
from laploop.envs.tasks.track import TrackEnv
from laploop.envs.theatre.config import TheatreConfig
from laploop.envs.theatre.organ_motion import BaseMotion

Array = NDArray[np.float64]
Result = TypeVar("Result")


@dataclass(frozen=True, kw_only=True)
class TickTimes:
    """Seconds of every tick."""

    whole: list[float] = field(default_factory=list)
    """Targeting, prediction by rhythms, and the arm's quadratic program."""
    core: list[float] = field(default_factory=list)
    """The same without the measurement of depth frames: kinematics, quadratic program and prediction alone."""


def tracking_tick_times(*, seed: int, seconds: float) -> tuple[TickTimes, TickTimes]:
    """Time the ticks of an episode of `Track` under breathing, with exact depth.

    Returns:
        In the loop, where physics, between two ticks, leaves nothing of them in the processor's caches; and alone: the same
        ticks once more, with the same input and to the same end, one right after another, as on a computer of their own.
    """
    theatre = TheatreConfig(motion=BaseMotion.named("breathing"))
    config = TrackConfig(loop=LoopConfig(theatre=theatre), max_seconds=seconds)
    env = TrackEnv(config, perception="oracle")
    env.reset(seed=seed)
    loop, alone = _TimedTicks(env), _TimedTicks(env)
    seen: list[tuple[ControlInput, Array, Array]] = []
    terminated = truncated = False
    while not (terminated or truncated):
        rotation = env.loop.theatre.world_from_camera()[:3, :3].copy()
        seen.append((env.control_input(), rotation, env.loop.scope.tip_pose_in_world().copy()))
        _, _, terminated, truncated, _ = env.step(loop.tick(*seen[-1]).astype(np.float32))
    for one in seen:
        alone.tick(*one)
    env.close()
    return loop.times, alone.times


def kinematics_beside(env: TaskEnv[Any]) -> RcmController:
    """Make a controller of the tool arm beside the one in the loop, at home."""
    arm = env.loop.theatre.tool_arm
    rcm = RcmController(ArmModel(arm.world_from_base, INSTRUMENT), arm.trocar_in_world, env.config.loop.rcm)
    rcm.reset(arm.home_q)
    return rcm


class _TimedTicks:
    """A controller with its kinematics, and how long they take."""

    def __init__(self, env: TrackEnv) -> None:
        self._predictor = _TimedPredictor()
        self._controller = TrackController(env.loop.rig, predictor=self._predictor)
        self._rcm = kinematics_beside(env)
        self._other_shaft: Shaft = env.loop.scope.model.shaft
        self._period_s = env.config.loop.control_s
        self.times = TickTimes()

    def tick(self, state: ControlInput, rotation: Array, scope_pose: Array) -> Array:
        """Return the velocity of the tip in the camera's frame."""
        self._predictor.spent_s = 0.0
        began = time.perf_counter()
        velocity = self._controller.command(state)
        commanded = time.perf_counter()
        self._rcm.set_other_shaft(scope_pose, self._other_shaft)
        self._rcm.step(rotation @ velocity, self._period_s)
        ended = time.perf_counter()
        self.times.whole.append(ended - began)
        self.times.core.append(self._predictor.spent_s + ended - commanded)
        return velocity


class _TimedPredictor:
    """A predictor by rhythms that tells how long it has worked."""

    def __init__(self) -> None:
        self._predictor = RhythmPredictor()
        self.spent_s = 0.0

    def reset(self) -> None:
        self._predictor.reset()

    def update(self, measured: float | None, captured_ns: int) -> bool:
        return self._took(time.perf_counter(), self._predictor.update(measured, captured_ns))

    def predict(self, at_ns: int) -> Prediction:
        return self._took(time.perf_counter(), self._predictor.predict(at_ns))

    def work(self) -> None:
        began = time.perf_counter()
        self._predictor.work()
        self.spent_s += time.perf_counter() - began

    def _took(self, began: float, result: Result) -> Result:
        self.spent_s += time.perf_counter() - began
        return result
