"""What a learner observes: one vector, an image, or both."""

from collections.abc import Mapping
from typing import Any, cast

import numpy as np
from gymnasium import spaces

from laploop.arrays import Array
from laploop.envs.learning.encoding import VectorLayout, encode_depth, encode_stripes
from laploop.envs.learning.options import ObservationName
from laploop.envs.learning.privileged import PRIVILEGED
from laploop.envs.tasks.task_env import TaskEnv
from laploop.envs.wrappers.frames import frame_time

_OWN_SENSES: Mapping[str, int] = {"tip_position": 3, "tip_velocity": 3, "contact_force": 3}


def vector_layout(observation: ObservationName, env: TaskEnv[Any]) -> VectorLayout:
    """Return the layout of the vector that is observed: the robot's own senses, the task's own keys, and the truth."""
    sizes = dict(_OWN_SENSES) if observation == "state" else {**_OWN_SENSES, "frame_age": 1}
    observed = cast("spaces.Dict", env.observation_space)
    own = {key: cast("spaces.Box", observed[key]) for key in _task_keys(env)}
    senses = VectorLayout.of(sizes, own)
    return senses + PRIVILEGED if "state" in observation else senses


def observation_space(observation: ObservationName, env: TaskEnv[Any], layout: VectorLayout) -> spaces.Space[Any]:
    """Return the space of what is observed of a task."""
    scope, vector = env.config.loop.theatre.scope, layout.space()
    image = spaces.Box(0, 255, (scope.height, scope.width, 1), np.uint8)
    parts: dict[str, dict[str, spaces.Space[Any]]] = {
        "depth": {"depth": image, "proprioception": vector},
        "stripes": {"stripes": image, "proprioception": vector},
        "depth+state": {"depth": image, "state": vector},
    }
    found = parts.get(observation)
    return vector if found is None else spaces.Dict(found)


def encoded_observation(
    observation: ObservationName,
    env: TaskEnv[Any],
    layout: VectorLayout,
    observed: Mapping[str, Any],
    truth: Mapping[str, Array],
) -> Any:
    """Return the observation of what a task observes, and of the truth where that belongs to it."""
    frame_age = np.array([_frame_age_s(observation, env)])
    own = {key: np.ravel(observed[key]) for key in (*_OWN_SENSES, *_task_keys(env))}
    vector = layout.encode({**truth, **own, "frame_age": frame_age})
    if observation == "state":
        return vector
    if observation == "stripes":
        return {"stripes": encode_stripes(observed["stripes"]), "proprioception": vector}
    depth = encode_depth(observed["depth_mm"], observed["depth_valid"])
    return {"depth": depth, "state" if observation == "depth+state" else "proprioception": vector}


def _task_keys(env: TaskEnv[Any]) -> tuple[str, ...]:
    return ("target_pixel", *env.extra_spaces())


def _frame_age_s(observation: ObservationName, env: TaskEnv[Any]) -> float:
    """Return the time since the observed frame was captured, by its time stamp."""
    shown = frame_time(env, "stripes" if observation == "stripes" else "depth")
    return (env.loop.now_ns - shown.stamped_ns) * 1e-9
