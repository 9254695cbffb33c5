"""Which entries of an observation are images, and from which frame they are."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from gymnasium import spaces

from laploop.envs.tasks.task_env import TaskEnv
from laploop.errors import InvalidValueError, SimulationError

_LEAST_SIDE = 16
"""An array of fewer rows or columns is no image."""

WHOLE = ""
"""Key of an observation that is one image."""

AGE_KEYS = ("depth_age_s",)
"""Entries that tell the age of the newest frame."""


class FrameTime(NamedTuple):
    """Simulated times of a frame."""

    captured_ns: int
    stamped_ns: int
    """The same by its time stamp, which is what a consumer believes."""
    arrived_ns: int
    """At those who observe it."""


def image_spaces(space: spaces.Space[Any], user: str) -> Mapping[str, spaces.Box]:
    """Return the images of an observation space by key: those of a `Dict`, or the whole of a `Box`.

    Raises:
        InvalidValueError: If there is none for the wrapper named.
    """
    entries = space.spaces.items() if isinstance(space, spaces.Dict) else [(WHOLE, space)]
    found = {key: entry for key, entry in entries if isinstance(entry, spaces.Box) and _is_image(entry)}
    if not found:
        raise InvalidValueError(f"observation space of {user}", space, "one with images: stripes or depth")
    return found


def frame_time(task: TaskEnv[Any], key: str) -> FrameTime:
    """Return the time of the frame that an image of the present observation shows.

    Stripes are those of the newest image that has arrived from the camera, depth is that of the newest that has been served.

    Raises:
        SimulationError: If no episode has begun.
    """
    loop = task.loop
    stripes = key == "stripes" or (key == WHOLE and task.config.observation_mode == "stripes")
    served = loop.newest_served
    frame = loop.newest_arrived if stripes else None if served is None else served.captured
    if frame is None or served is None:
        raise SimulationError("no frame has arrived; call reset() first")
    return FrameTime(frame.captured_ns, frame.time_stamp_ns, frame.available_ns if stripes else served.available_ns)


def _is_image(space: spaces.Box) -> bool:
    return len(space.shape) in {2, 3} and min(space.shape[:2]) >= _LEAST_SIDE
