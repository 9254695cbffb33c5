"""The simulator's truth for a critic: what no sensor tells, along the camera's axes."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from laploop.arrays import Array
from laploop.envs.learning.encoding import VectorLayout
from laploop.envs.tasks.task_env import TaskEnv

PRIVILEGED = VectorLayout.of(
    {"to_target": 3, "target_normal": 3, "tissue_velocity": 3, "true_force": 3, "target_distance": 1}, {}
)
"""Where the vector holds what, and its scales."""


def tip_to_target(env: TaskEnv[Any]) -> Array:
    """Return the way from the tool's tip to the target, (3,), metres along the camera's axes."""
    offset, _, _ = env.target_offset()
    return np.asarray(env.loop.theatre.world_from_camera()[:3, :3].T @ -offset)


def privileged_quantities(env: TaskEnv[Any], to_target: Array) -> Mapping[str, Array]:
    """Return the truth of a running episode, by the names of `PRIVILEGED`, in SI units.

    - `to_target`, (3,), m: what is given, the way from the moved tip to the target;
    - `target_normal`, (3,): of the tissue at the target, towards the outside;
    - `tissue_velocity`, (3,), m/s: of the stage below the tissue, by breathing, heartbeat and travel;
    - `true_force`, (3,), N: on the tool's tip, without the sensor's delay and noise;
    - `target_distance`, (1,), m: what the task calls the target error.
    """
    theatre, control_ns = env.loop.theatre, env.config.loop.control_ns
    camera_axes = theatre.world_from_camera()[:3, :3].T
    _, normal, _ = env.target_offset()
    moved = theatre.stage.position(theatre.now_ns) - theatre.stage.position(theatre.now_ns - control_ns)
    return {
        "to_target": to_target,
        "target_normal": camera_axes @ normal,
        "tissue_velocity": camera_axes @ moved / (control_ns * 1e-9),
        "true_force": camera_axes @ theatre.contact_force_in_world(),
        "target_distance": np.array([env.target_error_mm() * 1e-3]),
    }
