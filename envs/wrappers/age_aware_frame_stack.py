"""The last frames of a camera, each once, with their ages."""

from collections import deque
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from numpy.typing import NDArray

from laploop.envs.tasks.observations import MAX_AGE_S
from laploop.envs.wrappers.chain_state import StatefulWrapper
from laploop.envs.wrappers.frames import WHOLE, frame_time, image_spaces
from laploop.errors import InvalidValueError

NO_FRAME_S = -1.0
"""Age of a place in the stack that no frame has taken yet; its pixels are 0."""


class AgeAwareFrameStack(StatefulWrapper):
    """Stacks the last k distinct frames, and says how old each is.

    Where a camera is slower than decisions, or frames are late or lost, a plain stack holds the same frame several times, and
    a policy cannot tell motion from waiting. Here a frame is in the stack once, however long it is the newest.

    Every image of the observation, (height, width) or (height, width, 1), becomes (height, width, k), the newest frame last.
    A `Dict` gets an entry more for each, `<name>_ages_s`, (k,): seconds since the capture by the time stamp, or -1 where there
    was no frame yet. An observation that is one image becomes a `Dict` with `frames` and `frames_ages_s`.
    """

    def __init__(self, env: gym.Env[Any, Any], k: int = 4) -> None:
        """Wrap an environment.

        Args:
            env: One that observes images.
            k: Number of frames.

        Raises:
            InvalidValueError: If it observes none, an image has several channels, or `k` is not an integer from 1 to 64.
        """
        RecordConstructorArgs.__init__(self, k=k)
        super().__init__(env)
        if not isinstance(k, int) or not 1 <= k <= 64:
            raise InvalidValueError("k", k, "an integer, 1 to 64")
        observed = env.observation_space
        images = image_spaces(observed, "AgeAwareFrameStack")
        found: dict[str, spaces.Space[Any]] = {}
        self._stacks: dict[str, deque[tuple[int, int, NDArray[Any]]]] = {}
        for key, space in images.items():
            if space.shape[2:] not in {(), (1,)}:
                raise InvalidValueError("channels of an image of AgeAwareFrameStack", space.shape[2:], "none, or one")
            low, high = np.atleast_3d(space.low), np.atleast_3d(space.high)
            # Places without a frame are 0.
            low, high = np.minimum(low, 0), np.maximum(high, 0)
            found[_name(key)] = spaces.Box(np.repeat(low, k, axis=2), np.repeat(high, k, axis=2), dtype=space.dtype.type)
            found[f"{_name(key)}_ages_s"] = spaces.Box(NO_FRAME_S, MAX_AGE_S, (k,), np.float32)
            self._stacks[key] = deque(maxlen=k)
        others = observed.spaces if isinstance(observed, spaces.Dict) else {}
        self.observation_space = spaces.Dict({**others, **found})

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin with one frame."""
        observation, info = self.env.reset(seed=seed, options=options)
        for stack in self._stacks.values():
            stack.clear()
        return self._observed(observation), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step, and add the frame if it is new."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._observed(observation), reward, terminated, truncated, info

    def _observed(self, observation: Any) -> dict[str, Any]:
        task = self.task_env
        shown: dict[str, Any] = {} if WHOLE in self._stacks else dict(observation)
        for key, stack in self._stacks.items():
            time = frame_time(task, key)
            image = np.atleast_3d(observation if key == WHOLE else observation[key])
            if not stack or time.captured_ns > stack[-1][0]:
                stack.append((time.captured_ns, time.stamped_ns, image))
            missing = (stack.maxlen or 0) - len(stack)
            images = [np.zeros_like(image)] * missing + [kept for _, _, kept in stack]
            ages_s = [(task.loop.now_ns - stamped_ns) * 1e-9 for _, stamped_ns, _ in stack]
            shown[_name(key)] = np.concatenate(images, axis=2)
            shown[f"{_name(key)}_ages_s"] = np.array([NO_FRAME_S] * missing + ages_s, np.float32).clip(NO_FRAME_S, MAX_AGE_S)
        return shown


def _name(key: str) -> str:
    return key or "frames"
