"""One closed-loop episode with a scripted controller, and its summary."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np

from laploop.assets.phantom import TissueConfig
from laploop.assets.phantom_mesh import load_phantom
from laploop.control.messages import TipController
from laploop.control.reach_controller import ReachController
from laploop.envs.base_motion import BaseMotion, MotionName
from laploop.envs.closed_loop import LoopConfig
from laploop.envs.latency import ConstantLatency
from laploop.envs.reach_env import ReachConfig, ReachEnv
from laploop.envs.recorder import Recorder
from laploop.errors import InvalidValueError, UnknownNameError
from laploop.perception.estimators.base import DepthEstimator
from laploop.perception.estimators.registry import estimator_names

TASKS = ("reach",)


@dataclass(frozen=True, kw_only=True)
class EpisodeConfig:
    """What to run, in words and numbers that a command line can give."""

    task: str = "reach"
    """What to do: reach (touch a point that was chosen in the first frame)."""
    perception: str = "compact"
    """Depth estimator: compact (network), phase (classical demodulation), oracle (exact depth)."""
    motion: str = "still"
    """How the tissue moves: still, breathing (10 mm, 0.25 Hz), beating (1 mm, 1.2 Hz), or both."""
    seed: int = 0
    """Decides the tissue, the target and all noise."""
    seconds: float = 10.0
    """Simulated time after which the episode ends unsolved."""
    hold_s: float = 0.3
    """For how long without a break the tip must stay within 1.5 mm of an ideal touch; then the episode ends as a success."""
    perception_latency_ns: int = 40_000_000
    """From the capture of a frame to the arrival of its depth, in nanoseconds of simulated time."""
    phantom: Path | None = None
    """Closed surface to be the tissue instead of a seeded one: .stl, .obj or .ply, millimetres, z up, 20-200 mm a side."""

    def __post_init__(self) -> None:
        """Check names and ranges.

        Raises:
            UnknownNameError: If there is no such task, estimator or motion.
            InvalidValueError: If a number is out of range.
        """
        for kind, name, available in (
            ("task", self.task, TASKS),
            ("perception", self.perception, estimator_names()),
            ("motion", self.motion, get_args(MotionName)),
        ):
            if name not in available:
                raise UnknownNameError(kind, name, available)
        if isinstance(self.seed, bool) or not isinstance(self.seed, int) or not 0 <= self.seed < 2**31:
            raise InvalidValueError("seed", self.seed, "an integer from 0 to 2**31 - 1")
        if not 0.0 < self.seconds <= 3600.0:
            raise InvalidValueError("seconds", self.seconds, "above 0, at most 3600")
        if not 0.0 < self.hold_s <= 3600.0:
            raise InvalidValueError("hold_s", self.hold_s, "above 0, at most 3600")
        if not 0 <= self.perception_latency_ns <= 5_000_000_000:
            raise InvalidValueError("perception_latency_ns", self.perception_latency_ns, "0 to 5e9 (5 s)")

    def reach_config(self) -> ReachConfig:
        """Translate into the environment's configuration; reads, checks and fills the phantom where one is given.

        Raises:
            MissingFileError: If the phantom's file does not exist.
            InvalidValueError: If it is not one closed surface of sensible size.
        """
        return ReachConfig(
            tissue=TissueConfig(solid=None if self.phantom is None else load_phantom(self.phantom)),
            motion=BaseMotion.named(self.motion),
            loop=LoopConfig(latency=ConstantLatency(latency_ns=self.perception_latency_ns)),
            max_seconds=self.seconds,
            success_hold_s=self.hold_s,
        )


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
        recorder: Told everything; closed if the episode ends as it should.
        progress: Called with the simulated seconds so far, every control period.
        estimator: Used instead of the one that `config.perception` names.
        controller: Used instead of the scripted one.

    Returns:
        The summary: outcome, errors, forces, ages of depth, and the wall-clock time of each stage.
    """
    env = ReachEnv(config.reach_config(), perception=estimator or config.perception, recorder=recorder)
    try:
        controller = controller or ReachController(env.loop.rig)
        controller.reset()
        _, info = env.reset(seed=config.seed)
        infos: list[dict[str, Any]] = []
        begin_wall, begin_sim = time.perf_counter(), info["sim_s"]
        finished = False
        while not finished:
            with env.loop.timer.measure("control"):
                velocity = controller.command(env.control_input())
            _, _, terminated, truncated, info = env.step(velocity.astype(np.float32))
            finished = terminated or truncated
            infos.append(info)
            if progress is not None:
                progress(info["sim_s"])
        wall_s = time.perf_counter() - begin_wall
        summary = _summary(config, env, infos, (info["sim_s"] - begin_sim) / wall_s)
        if recorder is not None:
            recorder.close()
        return summary
    finally:
        env.close()


def _summary(config: EpisodeConfig, env: ReachEnv, infos: list[dict[str, Any]], real_time_factor: float) -> dict[str, Any]:
    last = infos[-1]
    hold_ticks = max(1, round(env.config.success_hold_s / env.config.loop.rates.control_s))
    held_errors = [info["target_error_mm"] for info in infos[-hold_ticks:]]
    ages = [info["depth_age_ms"] for info in infos]
    return {
        "task": config.task,
        "perception": config.perception,
        "motion": config.motion,
        "success": last["success"],
        "terminated_by": last["terminated_by"],
        "sim_s": last["sim_s"],
        "real_time_factor": real_time_factor,
        "frames": last["frames"],
        # Mean and 95th percentile of the final hold: before it, the distance still to go says nothing about accuracy.
        "target_error_mm": {
            "mean": float(np.mean(held_errors)),
            "p95": float(np.percentile(held_errors, 95)),
            "final": last["target_error_mm"],
        },
        "rcm_error_mm": {f"{arm}_max": max(info["rcm_error_mm"][arm] for info in infos) for arm in ("camera", "tool")},
        "contact_force_n": {"max": max(info["contact_force_n"] for info in infos)},
        "depth_mae_mm": float(np.nanmean([info["depth_mae_mm"] for info in infos])),
        "depth_valid_fraction": float(np.mean([info["depth_valid_fraction"] for info in infos])),
        "depth_age_ms": {"mean": float(np.mean(ages)), "p99": float(np.percentile(ages, 99))},
        "stage_ms": env.loop.timer.median_ms(),
    }
