"""One closed-loop episode with a scripted controller, and its summary."""

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any, get_args

import numpy as np

from laploop.arrays import Array
from laploop.assets.phantom_import.phantom_mesh import load_phantom
from laploop.control.controllers.base import TaskController
from laploop.control.controllers.registry import make_controller
from laploop.control.messages import TipController
from laploop.envs.episode_config import OWN, EpisodeConfig
from laploop.envs.loop.timing.log import FrameFate
from laploop.envs.recording.recorder import PredictionRecord, Recorder
from laploop.envs.recording.tick_table import TickTable
from laploop.envs.tasks.actions import checked_command
from laploop.envs.tasks.registry import task_spec
from laploop.envs.tasks.task_env import TaskEnv
from laploop.perception.estimators.base import DepthEstimator
from laploop.perception.estimators.registry import make_estimator
from laploop.perception.geometry import Rig, invert_transform, transform_points


def run_episode(
    config: EpisodeConfig,
    recorder: Recorder | None = None,
    progress: Callable[[float], None] | None = None,
    estimator: DepthEstimator | None = None,
    controller: TipController | None = None,
    ticks: TickTable | None = None,
) -> dict[str, Any]:
    """Run an episode to its end.

    Args:
        config: What to run.
        recorder: Receives everything, and is closed at the end, however the episode ends.
        progress: Called with the simulated seconds so far, every control period.
        estimator: Used instead of the one that `config.perception` names.
        controller: Used instead of the scripted one. A command that is not finite makes the arm hold for that period.
        ticks: Is given every control tick.

    Returns:
        The summary: outcome, errors, forces, limits, ages of depth, and the wall-clock time of each stage.

    Raises:
        MissingFileError: If the file of the weights does not exist.
        WeightsError: If it is damaged, or made for another network.
        InvalidValueError: If the estimator has no weights.
    """
    if (mesh := config.task.loop.theatre.tissue.mesh) is not None:
        load_phantom(mesh)
    spec = task_spec(config.task.kind)
    rig = Rig.from_optics(config.task.loop.theatre.scope)
    estimator = estimator or make_estimator(config.perception.name, rig, config.perception.weights, config.perception.arguments)
    # Controllers know what `control_input` tells them; nobody looks at observations.
    task = replace(config.task, observation_mode="state")
    env = spec.environment_class(task, perception=estimator, recorder=recorder)
    try:
        if controller is None:
            controller = make_controller(
                spec.controller if config.controller.name == OWN else config.controller.name,
                rig,
                prediction=None if config.predictor.name == OWN else config.predictor.name,
                prediction_arguments=config.predictor.arguments,
                arguments=config.controller.arguments,
            )
        controller.reset()
        _, info = env.reset(seed=config.seed)
        infos: list[dict[str, Any]] = []
        begin_wall, begin_sim = time.perf_counter(), info["sim_s"]
        finished = False
        while not finished:
            known = env.control_input()
            with env.loop.timer.measure("control"):
                velocity = checked_command(controller.command(known))
            _begin_tick(env, controller, velocity, ticks)
            _, _, terminated, truncated, info = env.step(velocity.astype(np.float32))
            finished = terminated or truncated
            if isinstance(controller, TaskController):
                info["depth_jump_fraction"] = controller.depth_jump_fraction
            if ticks is not None:
                ticks.end(info)
            infos.append(info)
            if progress is not None:
                progress(info["sim_s"])
        wall_s = time.perf_counter() - begin_wall
        if recorder is not None:
            recorder.timing(env.loop.timing_log)
        return _summary(config, env, infos, (info["sim_s"] - begin_sim) / wall_s)
    finally:
        env.close()
        if recorder is not None:
            recorder.close()


def _begin_tick(env: TaskEnv[Any], controller: TipController, velocity: Array, ticks: TickTable | None) -> None:
    """Note what a controller knows and commands, before its command is carried out."""
    target = controller.target if isinstance(controller, TaskController) else None
    if ticks is not None:
        ticks.begin(env, velocity, None if target is None else target.point)
    loop = env.loop
    if target is not None and loop.recorder.takes_ticks:
        prediction = PredictionRecord(
            now_ns=loop.now_ns,
            predicted_in_camera=target.point,
            true_in_camera=transform_points(invert_transform(loop.theatre.world_from_camera()), env.target_in_world()),
            predicted_in_world=transform_points(loop.scope.world_from_camera(), target.point),
        )
        with loop.timer.measure("record"):
            loop.recorder.prediction(prediction)


def _summary(config: EpisodeConfig, env: TaskEnv[Any], infos: list[dict[str, Any]], real_time_factor: float) -> dict[str, Any]:
    last = infos[-1]
    held_errors = [info["target_error_mm"] for info in env.assessed(infos)]
    ages = [info["depth_age_ms"] for info in infos]
    depth_errors = [info["depth_mae_mm"] for info in infos if not np.isnan(info["depth_mae_mm"])]
    return {
        "task": config.task.kind,
        "perception": config.perception.name,
        "motion": config.motion_name(),
        "actuation": config.actuation_name(),
        "success": last["success"],
        "terminated_by": last["terminated_by"],
        "sim_s": last["sim_s"],
        "real_time_factor": real_time_factor,
        "frames": last["frames"],
        "dropped": {fate: env.loop.timing_log.dropped[fate] for fate in get_args(FrameFate)},
        "out_of_order": env.loop.timing_log.out_of_order,
        "overtaken_commands": env.loop.timing_log.overtaken_commands,
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
        "limits": asdict(env.loop.watch.worst),
        "depth_mae_mm": float(np.mean(depth_errors)) if depth_errors else float("nan"),
        "depth_valid_fraction": float(np.mean([info["depth_valid_fraction"] for info in infos])),
        # Of the target's surroundings; 0 for a controller that does not say.
        "depth_jump_fraction": {"max": max(info["depth_jump_fraction"] or 0.0 for info in infos)},
        "depth_age_ms": {"mean": float(np.mean(ages)), "p99": float(np.percentile(ages, 99))},
        "stage_ms": env.loop.timer.median_ms(),
    }
