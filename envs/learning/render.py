"""What `render` shows of an episode."""

from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from laploop.envs.learning.options import ViewName
from laploop.envs.recording.recorder import CompositeRecorder, Recorder
from laploop.envs.recording.rerun_viewer import RerunViewer
from laploop.envs.sensors.overview_camera import OverviewCamera
from laploop.envs.tasks.task_env import TaskEnv
from laploop.errors import SimulationError, UnknownNameError
from laploop.perception.geometry import invert_transform, transform_points

RenderMode = Literal["rgb_array", "human"]
RENDER_MODES = ("rgb_array", "human")

HEIGHT = 384
"""Of a picture, pixels; even, as video formats want it."""
_OVERVIEW_WIDTH = 512
_TARGET_COLOR = (60, 220, 90)


def viewer_of(mode: str | None) -> RerunViewer | None:
    """Return the viewer of the mode `human`, and None in others.

    Raises:
        UnknownNameError: If there is no such mode.
    """
    if mode is not None and mode not in RENDER_MODES:
        raise UnknownNameError("render mode", mode, RENDER_MODES)
    return RerunViewer() if mode == "human" else None


def joined(*recorders: Recorder | None) -> Recorder | None:
    """Return one recorder for those that are there."""
    present = [recorder for recorder in recorders if recorder is not None]
    return CompositeRecorder(present) if len(present) > 1 else next(iter(present), None)


class EpisodeView:
    """Pictures of an environment: the newest frame of the scope with the target, and the theatre from the side."""

    def __init__(self, view: ViewName, *, device: str) -> None:
        """Choose what is shown; the theatre's camera, on a device of Warp's, is made for the first picture."""
        self._view = view
        self._device = device
        self._overview: OverviewCamera | None = None

    def picture(self, env: TaskEnv[Any]) -> NDArray[np.uint8]:
        """Return the picture of now, (HEIGHT, width, 3) RGB."""
        parts = []
        if self._view in {"scope", "both"}:
            parts.append(_scope_picture(env))
        if self._view in {"overview", "both"}:
            self._overview = self._overview or OverviewCamera(width=_OVERVIEW_WIDTH, height=HEIGHT, device=self._device)
            parts.append(self._overview.picture(env.loop.theatre))
        return np.concatenate(parts, axis=1)

    def close(self) -> None:
        """End the threads."""
        if self._overview is not None:
            self._overview.close()
            self._overview = None

    def __getstate__(self) -> dict[str, Any]:
        """Return what copies and pickles: a copy makes a camera of its own."""
        return vars(self) | {"_overview": None}


def _scope_picture(env: TaskEnv[Any]) -> NDArray[np.uint8]:
    """Return the newest frame captured, as a square, and a ring where the target is now."""
    loop = env.loop
    if loop.newest_captured is None:
        raise SimulationError("no frame yet")
    camera = loop.rig.camera
    width = 2 * round(HEIGHT * camera.width / camera.height / 2)
    grey = cv2.resize(loop.newest_captured.frame.image, (width, HEIGHT), interpolation=cv2.INTER_LINEAR)
    picture = np.repeat(grey[..., None], 3, axis=2)
    target = transform_points(invert_transform(loop.theatre.world_from_camera()), env.target_in_world())
    if target[2] > 0.0:
        column, row = camera.project(target) * [width / camera.width, HEIGHT / camera.height]
        cv2.circle(picture, (round(float(column)), round(float(row))), 7, _TARGET_COLOR, 1, cv2.LINE_AA)
    return np.asarray(picture, dtype=np.uint8)
