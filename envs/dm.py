"""The tasks behind dm_env's interface, for Acme and other agents that are written for it."""

from typing import Any

import dm_env
import gymnasium as gym
import numpy as np
from dm_env import specs
from gymnasium import spaces

from laploop.envs.tasks.registry import make_environment
from laploop.envs.wrappers.chain_state import ChainState, get_state, set_state
from laploop.errors import InvalidValueError


def load(task: str, *, seed: int | None = None, **keywords: Any) -> "DmEnvironment":
    """Make the environment of a task.

    Args:
        task: Its name, such as `reach`.
        seed: Decides all episodes.
        keywords: As for `gymnasium.make` of the task.

    Raises:
        UnknownNameError: If there is no such task.
    """
    return DmEnvironment(make_environment(task, **keywords), seed=seed)


class DmEnvironment(dm_env.Environment):  # type: ignore[misc]  # dm_env has no types
    """An environment of Gymnasium's as one of dm_env's.

    An episode that is truncated, by its time, ends with discount 1: what comes after it is worth something. One that
    terminates ends with discount 0. The first `step`, and one after an end, begin an episode and ignore the action.
    """

    def __init__(self, env: gym.Env[Any, Any], *, seed: int | None = None) -> None:
        """Take over an environment, wrapped or not; the seed decides all its episodes."""
        self.env = env
        """Gymnasium's environment; `info` of its last step is in `info`."""
        self.info: dict[str, Any] = {}
        self._seed = seed
        self._over = True

    def reset(self) -> dm_env.TimeStep:
        """Begin an episode."""
        seed, self._seed = self._seed, None
        observation, self.info = self.env.reset(seed=seed)
        self._over = False
        return dm_env.restart(observation)

    def step(self, action: Any) -> dm_env.TimeStep:
        """Step, or begin an episode where none is running."""
        if self._over:
            return self.reset()
        observation, reward, terminated, truncated, self.info = self.env.step(action)
        self._over = terminated or truncated
        if terminated:
            return dm_env.termination(float(reward), observation)
        if truncated:
            return dm_env.truncation(float(reward), observation)
        return dm_env.transition(float(reward), observation)

    def observation_spec(self) -> Any:
        """Return the spec of an observation, or a dictionary of them."""
        return _spec(self.env.observation_space, "observation")

    def action_spec(self) -> Any:
        """Return the spec of an action."""
        return _spec(self.env.action_space, "action")

    def reward_spec(self) -> specs.Array:
        """Return the spec of a reward."""
        return specs.Array((), np.float64, "reward")

    def close(self) -> None:
        """Close Gymnasium's environment."""
        self.env.close()

    def get_state(self) -> tuple[ChainState, int | None, bool]:
        """Return everything that shapes the future; errors as for `TaskEnv.get_state`."""
        return get_state(self.env), self._seed, self._over

    def set_state(self, state: tuple[ChainState, int | None, bool]) -> None:
        """Go on from a state of an environment like this one; errors as for `TaskEnv.set_state`."""
        chain, self._seed, self._over = state
        set_state(self.env, chain)


def _spec(space: spaces.Space[Any], name: str) -> Any:
    if isinstance(space, spaces.Dict):
        return {key: _spec(inner, key) for key, inner in space.spaces.items()}
    if isinstance(space, spaces.Box):
        return specs.BoundedArray(space.shape, space.dtype, space.low, space.high, name)
    raise InvalidValueError(f"space of {name}", space, "a Box, or a Dict of these")
