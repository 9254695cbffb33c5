"""A random delay made constant, at its worst case."""

from collections import deque
from typing import Any

import gymnasium as gym
from gymnasium.utils import RecordConstructorArgs

from laploop.envs.loop.timing.latency import LONGEST_MS
from laploop.envs.tasks.observations import MAX_AGE_S, bounded
from laploop.envs.wrappers.chain_state import StatefulWrapper
from laploop.envs.wrappers.frames import AGE_KEYS, WHOLE, FrameTime, frame_time, image_spaces
from laploop.errors import InvalidValueError


class ConservativeAgent(StatefulWrapper):
    """Holds every image back until it is of a fixed age, so that random delays look like a constant one.

    The conservative agent of Lee, Kim, Jeong and Han (arXiv 2507.18992) uses an observation only once the longest possible
    delay has passed since it was made. Any method for constant delays then applies, such as `ActionHistory`, and the outcome
    depends on the longest delay alone, not on how delays are distributed below it.

    Images (stripes or depth) are those of the newest frame that is at least `age_ms` old; readings of the arm itself, which
    have a delay of their own, pass. An entry `depth_age_s` is that of the frame shown, by its time stamp. In the first
    `age_ms` of an episode the first frame is shown. A frame that comes later than `age_ms` is shown when it comes, and
    `info["late_frame"]` says so.
    """

    def __init__(self, env: gym.Env[Any, Any], age_ms: float) -> None:
        """Wrap an environment.

        Args:
            env: One that observes images.
            age_ms: The longest delay, from the capture of a frame to its arrival.

        Raises:
            InvalidValueError: If it observes none, or the age is not above 0 and at most 5000.
        """
        RecordConstructorArgs.__init__(self, age_ms=age_ms)
        super().__init__(env)
        if not isinstance(age_ms, int | float) or not 0.0 < age_ms <= LONGEST_MS:
            raise InvalidValueError("age_ms", age_ms, f"above 0 and at most {LONGEST_MS:g}")
        self._keys = tuple(image_spaces(env.observation_space, "ConservativeAgent"))
        self._age_ns = round(age_ms * 1e6)
        self._held: dict[str, deque[tuple[FrameTime, Any]]] = {}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode with its first frame."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._held = {key: deque() for key in self._keys}
        observation, late = self._observed(observation)
        return observation, info | {"late_frame": late}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step, and show the images that are old enough."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        observation, late = self._observed(observation)
        return observation, reward, terminated, truncated, info | {"late_frame": late}

    def _observed(self, observation: Any) -> tuple[Any, bool]:
        """Return the observation with images of the right age, and whether one has come too late for that."""
        task = self.task_env
        now_ns, late = task.loop.now_ns, False
        shown: dict[str, Any] = {}
        for key, held in self._held.items():
            time = frame_time(task, key)
            if not held or time.captured_ns > held[-1][0].captured_ns:
                late |= time.arrived_ns - time.captured_ns > self._age_ns
                held.append((time, observation if key == WHOLE else observation[key]))
            while len(held) > 1 and now_ns - held[1][0].captured_ns >= self._age_ns:
                held.popleft()
            time, shown[key] = held[0]
            if key != "stripes":
                age_s = bounded([(now_ns - time.stamped_ns) * 1e-9], 0.0, MAX_AGE_S)
                shown |= {age: age_s for age in AGE_KEYS if key != WHOLE and age in observation}
        return (shown[WHOLE] if self._keys == (WHOLE,) else {**observation, **shown}), late
