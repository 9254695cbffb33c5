"""A depth map turned into the few numbers that a small network needs to follow a target."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from laploop.arrays import Array, Float32
from laploop.envs.learning.encoding import BOUND, SCALES, decode_depth
from laploop.envs.learning.learner_env import LearnerEnv
from laploop.errors import InvalidValueError

_PATCH = 7
"""Half the side of the square of pixels that tell the target's depth and the surface's slope at the begin."""
_TOOL_M = 0.008
"""A pixel whose depth changes by more than this beside the others shows the tool now, or did so first."""
_EVERY = 4
"""Of so many rows and columns one tells how the tissue moves: 4096 pixels, of which the tool hides a few per cent."""


class TargetInDepth(gym.ObservationWrapper[Any, Any, Any]):
    """Replaces depth maps by what they tell of the target; nothing but what is observed is used.

    The target's place and the normal there are read in the first map. From then on the tool may hide it, so the motion of all
    tissue along the view is taken for that of the target. The observation is the vector of the robot's own
    senses, then, scaled as in `laploop.envs.learning.encoding`: the way from the tip to the target as it was when the frame was
    taken (3), its normal (3), and how fast the tissue went along the view between the two newest maps that differ (1). They are
    taken to be as many decisions apart as the older one was shown for, the first two of an episode one.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        """Wrap an environment for learners that observes `depth`.

        Raises:
            InvalidValueError: If it observes anything else.
        """
        super().__init__(env)
        learner = env.unwrapped
        if not isinstance(learner, LearnerEnv) or learner.options.observation != "depth":
            raise InvalidValueError("env", type(learner).__name__, 'an environment for learners with observation="depth"')
        self._layout = learner.layout
        self._camera = learner.task_env.loop.rig.camera
        self._decision_s = learner.options.decision_period_ms * 1e-3
        self.observation_space = spaces.Box(-BOUND, BOUND, (self._layout.size + 7,), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Float32, dict[str, Any]]:
        """Look at the target in the first map."""
        observed, info = self.env.reset(seed=seed, options=options)
        depth_m = decode_depth(observed["depth"]).astype(np.float64) * 1e-3
        pixel = self._layout.decode(observed["proprioception"])["target_pixel"]
        self._first, self._shift = depth_m[::_EVERY, ::_EVERY], 0.0
        self._map, self._shown, self._speed = self._first, 0, 0.0
        self._target, self._normal = self._patch(depth_m, pixel)
        return self.observation(observed), info

    def observation(self, observation: dict[str, Any]) -> Float32:
        """Return the vector."""
        depth_m = decode_depth(observation["depth"][::_EVERY, ::_EVERY]).astype(np.float64) * 1e-3
        self._shown += 1
        shift = self._shift
        if not np.array_equal(depth_m, self._map, equal_nan=True):
            shift = self._moved(depth_m - self._first)
            # The first map is shown until whatever is on its way behind it arrives, which says nothing of the time between.
            decisions = 1 if self._map is self._first else self._shown
            self._speed = (shift - self._shift) / (decisions * self._decision_s)
            self._map, self._shift, self._shown = depth_m, shift, 0
        speed = self._speed
        tip = self._layout.decode(observation["proprioception"])["tip_position"]
        way = (self._target + np.array([0.0, 0.0, shift]) - tip) / SCALES["to_target"].scale
        seen = np.append(np.concatenate([way, self._normal]), speed / SCALES["tissue_velocity"].scale)
        return np.concatenate([observation["proprioception"], np.clip(seen, -BOUND, BOUND)], dtype=np.float32)

    def _moved(self, change_m: Array) -> float:
        """Return how far the tissue has moved along the view: the mean change of depth without what the tool has changed.

        A map has levels of 0.47 mm; a mean over thousands of pixels is far finer, a median is not.
        """
        if not np.isfinite(change_m).any():
            return self._shift
        tissue = np.abs(change_m - np.nanmedian(change_m)) < _TOOL_M
        return float(change_m[tissue].mean())

    def _patch(self, depth_m: Array, pixel: Array) -> tuple[Array, Array]:
        """Return the point under a pixel, (3,), and the normal there, (3,), of a plane through its surroundings.

        Where depth is not valid around it, the whole map has to do for the point, and the view's axis for the normal.
        """
        column, row = (round(float(part)) for part in pixel)
        rows, columns = np.mgrid[row - _PATCH : row + _PATCH + 1, column - _PATCH : column + _PATCH + 1]
        rows, columns = (np.clip(part.ravel(), 0, size - 1) for part, size in zip((rows, columns), depth_m.shape, strict=True))
        depths = depth_m[rows, columns]
        known = np.isfinite(depths)
        if known.sum() < 10:
            middle = float(np.nanmedian(depth_m)) if np.isfinite(depth_m).any() else 0.1
            return self._camera.unproject(pixel, middle), np.array([0.0, 0.0, -1.0])
        points = self._camera.unproject(np.stack([columns, rows], axis=-1)[known] + 0.5, depths[known])
        centre = points.mean(axis=0)
        normal = np.linalg.svd(points - centre)[2][2]
        normal = normal if normal[2] < 0.0 else -normal
        ray = self._camera.unproject(pixel, 1.0)
        return ray * float(centre @ normal) / float(ray @ normal), normal
