"""One closed-loop episode with a scripted controller, and its summary."""

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np

from laploop.assets.phantom_import.phantom_mesh import load_phantom
from laploop.assets.tissue_config import TissueConfig
from laploop.control.controllers.registry import make_controller
from laploop.control.messages import TipController
from laploop.control.targeting.targeting import PredictionName
from laploop.envs.loop.closed_loop import LoopConfig
from laploop.envs.loop.latency import ConstantLatency, LatencyModel, TraceLatency
from laploop.envs.recording.recorder import Recorder
from laploop.envs.sensors.optics.presets import PRESETS, optics_preset
from laploop.envs.tasks.registry import TASKS, task_environment
from laploop.envs.tasks.task_config import TaskConfig
from laploop.envs.tasks.task_env import TaskEnv
from laploop.envs.theatre.actuation import ActuationConfig, ActuationName
from laploop.envs.theatre.organ_motion import BaseMotion, MotionName
from laploop.envs.theatre.trocar import TrocarConfig, TrocarName
from laploop.errors import InvalidValueError, UnknownNameError
from laploop.perception.estimators.base import DepthEstimator
from laploop.perception.estimators.registry import ESTIMATORS, make_estimator
from laploop.perception.geometry import Rig

HOLDING_TASKS = ("reach", "palpate")
"""Tasks that end as a success once something was held for long enough."""

_MOVING_TASKS = {"track": "both", "look": "breathing"}
"""Tasks that are about motion, and how their environments' tissue moves by default; that of the others is still."""


@dataclass(frozen=True, kw_only=True)
class EpisodeConfig:
    """What to run, in words and numbers that a command line can give."""

    task: str = "reach"
    """What to do: reach (touch a point that was chosen in the first frame), track (hold 3 mm above it), palpate (press on it
    with 0.5 N), scan (follow a line drawn in the first frame), look (keep a point in the middle of the view)."""
    perception: str = "compact"
    """Depth estimator: compact (network), phase (classical demodulation), oracle (exact depth)."""
    weights: Path | None = None
    """Weights file (.safetensors) of a network, in place of the shipped one."""
    optics: str = "paper"
    """Light, surfaces and sensor: paper (the laparoscope that the simulator follows), ideal, worst."""
    motion: str | None = None
    """How the tissue moves: still, breathing (10 mm, 0.25 Hz), beating (1 mm, 1.2 Hz), or both. By default the task's own: both
    for track, breathing for look, still for the others."""
    seed: int = 0
    """Decides the tissue, the target and all noise."""
    seconds: float | None = None
    """Simulated time after which the episode ends: by default 10 s for reach and look, 15 palpate, 20 track, 30 scan."""
    hold_s: float | None = None
    """How long to hold until the episode ends as a success: within 1.5 mm of an ideal touch without a break for reach (by
    default 0.3 s), within 0.1 N of 0.5 N for 95 % of the time for palpate (3 s)."""
    actuation: str = "ideal"
    """How the arms follow their joint targets: ideal, ur5-cb (125 Hz, 35 ms delay, 30 ms lag), ur5-e (500 Hz, 34 and 20 ms)."""
    trocar: str = "lubricated"
    """What the wall and the seal of each trocar do to the shaft: lubricated (2 N/mm, 0.75 N of friction), dry (8 N), none."""
    perception_latency_ns: int = 40_000_000
    """From the capture of a frame to the arrival of its depth, in nanoseconds of simulated time."""
    latency_trace: Path | None = None
    """CSV file with a column latency_ms, as `laploop speed` writes it, replayed in place of the constant latency."""
    transfer_latency_ns: int = 0
    """From the capture of a frame to its arrival at the estimator, in nanoseconds; comes on top of the perception latency, but
    does not keep the estimator busy."""
    prediction: str | None = None
    """How the scripted controller bridges the age of the depth: none (holds the newest measurement), rate (goes on at the rate
    seen last), rhythms (learns breathing and heartbeat). By default rate for reach, rhythms for the others."""
    phantom: Path | None = None
    """Closed surface to be the tissue instead of a seeded one: .stl, .obj or .ply, millimetres, z up, 20-200 mm a side."""

    def __post_init__(self) -> None:
        """Check names and ranges.

        Raises:
            UnknownNameError: If there is no such task, estimator, motion or actuation.
            InvalidValueError: If a number is out of range.
        """
        for kind, name, available in (
            ("task", self.task, TASKS),
            ("perception", self.perception, ESTIMATORS.names()),
            ("motion", self.motion, get_args(MotionName)),
            ("actuation", self.actuation, get_args(ActuationName)),
            ("trocar", self.trocar, get_args(TrocarName)),
            ("optics", self.optics, PRESETS),
            ("prediction", self.prediction, get_args(PredictionName)),
        ):
            if name is not None and name not in available:
                raise UnknownNameError(kind, name, available)
        if isinstance(self.seed, bool) or not isinstance(self.seed, int) or not 0 <= self.seed < 2**31:
            raise InvalidValueError("seed", self.seed, "an integer from 0 to 2**31 - 1")
        if self.seconds is not None and not 0.0 < self.seconds <= 3600.0:
            raise InvalidValueError("seconds", self.seconds, "above 0, at most 3600")
        if self.hold_s is not None and not 0.0 < self.hold_s <= 3600.0:
            raise InvalidValueError("hold_s", self.hold_s, "above 0, at most 3600")
        if self.hold_s is not None and self.task not in HOLDING_TASKS:
            raise InvalidValueError("hold_s", self.hold_s, f"only with the tasks {' and '.join(HOLDING_TASKS)}")
        for name in ("perception_latency_ns", "transfer_latency_ns"):
            if not 0 <= getattr(self, name) <= 5_000_000_000:
                raise InvalidValueError(name, getattr(self, name), "0 to 5e9 (5 s)")

    def motion_name(self) -> str:
        """Return how the tissue moves."""
        return _MOVING_TASKS.get(self.task, "still") if self.motion is None else self.motion

    def duration_s(self) -> float:
        """Return the simulated time after which the episode ends."""
        return task_environment(self.task).default_config().max_seconds if self.seconds is None else self.seconds

    def task_config(self) -> TaskConfig:
        """Translate into the environment's configuration; reads phantom and latency trace where they are given.

        Raises:
            MissingFileError: If the file of the phantom or of the trace does not exist.
            InvalidValueError: If the phantom is not one closed surface of sensible size, or the trace has no times in it.
        """
        default: TaskConfig = task_environment(self.task).default_config()
        held: dict[str, Any] = {} if self.hold_s is None else {"success_hold_s": self.hold_s}
        if self.phantom is not None:
            load_phantom(self.phantom)
        return replace(
            default,
            tissue=TissueConfig(mesh=self.phantom),
            motion=BaseMotion.named(self.motion_name()),
            loop=LoopConfig(
                latency=self._latency(),
                transfer_ns=self.transfer_latency_ns,
                stripes=optics_preset(self.optics),
                actuation=ActuationConfig.named(self.actuation),
                trocar=TrocarConfig.named(self.trocar),
            ),
            max_seconds=self.duration_s(),
            # A controller that fails must not bring the arm's loop down.
            bad_action="hold",
            **held,
        )

    def _latency(self) -> LatencyModel:
        if self.latency_trace is not None:
            return TraceLatency.from_csv(self.latency_trace)
        return ConstantLatency(latency_ns=self.perception_latency_ns)


def run_episode(
    config: EpisodeConfig,
    recorder: Recorder | None = None,
    progress: Callable[[float], None] | None = None,
    estimator: DepthEstimator | None = None,
    controller: TipController | None = None,
) -> dict[str, Any]:
    """Run an episode to its end.

    Args:
        config: What to run.
        recorder: Receives everything, and is closed at the end, however the episode ends.
        progress: Called with the simulated seconds so far, every control period.
        estimator: Used instead of the one that `config.perception` names.
        controller: Used instead of the scripted one. A command that is not finite makes the arm hold for that period.

    Returns:
        The summary: outcome, errors, forces, limits, ages of depth, and the wall-clock time of each stage.

    Raises:
        MissingFileError: If the file of the weights does not exist.
        WeightsError: If it is damaged, or made for another network.
        InvalidValueError: If the estimator has no weights.
    """
    task_config = config.task_config()
    estimator = estimator or make_estimator(config.perception, Rig.from_optics(task_config.loop.scope), config.weights)
    env = task_environment(config.task)(task_config, perception=estimator, recorder=recorder)
    try:
        prediction = cast("PredictionName | None", config.prediction)
        controller = controller or make_controller(config.task, env.loop.rig, prediction)
        controller.reset()
        _, info = env.reset(seed=config.seed)
        infos: list[dict[str, Any]] = []
        begin_wall, begin_sim = time.perf_counter(), info["sim_s"]
        finished = False
        while not finished:
            with env.loop.timer.measure("control"):
                velocity = controller.command(env.control_input())
            _, _, terminated, truncated, info = env.step(np.asarray(velocity, dtype=np.float32))
            finished = terminated or truncated
            infos.append(info)
            if progress is not None:
                progress(info["sim_s"])
        wall_s = time.perf_counter() - begin_wall
        return _summary(config, env, infos, (info["sim_s"] - begin_sim) / wall_s)
    finally:
        env.close()
        if recorder is not None:
            recorder.close()


def _summary(config: EpisodeConfig, env: TaskEnv[Any], infos: list[dict[str, Any]], real_time_factor: float) -> dict[str, Any]:
    last = infos[-1]
    held_errors = [info["target_error_mm"] for info in env.assessed(infos)]
    ages = [info["depth_age_ms"] for info in infos]
    return {
        "task": config.task,
        "perception": config.perception,
        "motion": config.motion_name(),
        "actuation": config.actuation,
        "success": last["success"],
        "terminated_by": last["terminated_by"],
        "sim_s": last["sim_s"],
        "real_time_factor": real_time_factor,
        "frames": last["frames"],
        # Mean and 95th percentile of what the task assesses, as the final hold: before it, the distance still to go says
        # nothing about accuracy.
        "target_error_mm": {
            "mean": float(np.mean(held_errors)),
            "p95": float(np.percentile(held_errors, 95)),
            "final": last["target_error_mm"],
        },
        "metrics": env.metrics(),
        "status_ticks": dict(Counter(info["status"] for info in infos)),
        "fault_ticks": dict(Counter(info["fault"] for info in infos if info["fault"] is not None)),
        "rcm_error_mm": {f"{arm}_max": max(info["rcm_error_mm"][arm] for info in infos) for arm in ("camera", "tool")},
        "port_force_n": {f"{arm}_max": max(info["port_force_n"][arm] for info in infos) for arm in ("camera", "tool")},
        "contact_force_n": {"max": max(info["contact_force_n"] for info in infos)},
        "limits": env.loop.watch.worst.as_dict(),
        "depth_mae_mm": float(np.nanmean([info["depth_mae_mm"] for info in infos])),
        "depth_valid_fraction": float(np.mean([info["depth_valid_fraction"] for info in infos])),
        "depth_age_ms": {"mean": float(np.mean(ages)), "p99": float(np.percentile(ages, 99))},
        "stage_ms": env.loop.timer.median_ms(),
    }
