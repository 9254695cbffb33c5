"""What a policy has commanded lately, as part of what it observes."""

from collections import deque
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs

from laploop.arrays import Float32
from laploop.envs.tasks.observations import MAX_AGE_S, bounded
from laploop.envs.wrappers.chain_state import StatefulWrapper
from laploop.envs.wrappers.frames import AGE_KEYS, frame_time
from laploop.errors import InvalidValueError


class ActionHistory(StatefulWrapper):
    """Adds the last actions and the age of the newest depth to the observation.

    Under a delay of up to k steps, the newest depth together with the k actions since is a Markov state (Katsikopoulos and
    Engelbrecht, IEEE Trans Autom Control 2003;48:568). To a vector, they are appended: k actions, the oldest first, then the
    age in seconds. To a `Dict`, they are added as `past_actions`, (k, n), and `depth_age_s`, (1,), unless it has that already.
    Before the first step all actions are zero.
    """

    def __init__(self, env: gym.Env[Any, Any], k: int = 8) -> None:
        """Wrap an environment.

        Args:
            env: One whose observation is a vector or a `Dict`, and whose actions are a `Box`.
            k: Number of actions.

        Raises:
            InvalidValueError: If it is another, or `k` is not an integer from 1 to 1000.
        """
        RecordConstructorArgs.__init__(self, k=k)
        super().__init__(env)
        if not isinstance(k, int) or not 1 <= k <= 1000:
            raise InvalidValueError("k", k, "an integer, 1 to 1000")
        actions, observed = env.action_space, env.observation_space
        if not isinstance(actions, spaces.Box) or len(actions.shape) != 1:
            raise InvalidValueError("action space of ActionHistory", actions, "a Box of one axis")
        self._low, self._high = actions.low, actions.high
        low, high = np.tile(actions.low, (k, 1)), np.tile(actions.high, (k, 1))
        if isinstance(observed, spaces.Dict):
            age = {} if any(key in observed.spaces for key in AGE_KEYS) else {"depth_age_s": _age_space()}
            history = spaces.Box(low, high, dtype=np.float32)
            self.observation_space = spaces.Dict({**observed.spaces, "past_actions": history, **age})
            self._adds_age = bool(age)
        elif isinstance(observed, spaces.Box) and len(observed.shape) == 1:
            lowest = np.concatenate([observed.low, low.ravel(), [0.0]]).astype(np.float32)
            highest = np.concatenate([observed.high, high.ravel(), [MAX_AGE_S]]).astype(np.float32)
            self.observation_space = spaces.Box(lowest, highest, dtype=np.float32)
        else:
            raise InvalidValueError("observation space of ActionHistory", observed, "a Box of one axis, or a Dict")
        self._actions: deque[Float32] = deque(maxlen=k)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Forget the past actions."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._actions.extend(np.zeros_like(self._low) for _ in range(self._actions.maxlen or 0))
        return self._observed(observation), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Remember the action as it acts: within its bounds."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        acted = np.nan_to_num(np.asarray(action, dtype=np.float32))
        self._actions.append(np.clip(acted, self._low, self._high))
        return self._observed(observation), reward, terminated, truncated, info

    def _observed(self, observation: Any) -> Any:
        task = self.task_env
        age_s = bounded([(task.loop.now_ns - frame_time(task, "depth").stamped_ns) * 1e-9], 0.0, MAX_AGE_S)
        history = np.stack(self._actions).astype(np.float32)
        if isinstance(observation, dict):
            return {**observation, "past_actions": history} | ({"depth_age_s": age_s} if self._adds_age else {})
        return np.concatenate([observation, history.ravel(), age_s]).astype(np.float32)


def _age_space() -> spaces.Box:
    return spaces.Box(0.0, MAX_AGE_S, (1,), np.float32)
