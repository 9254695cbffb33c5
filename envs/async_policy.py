"""A policy that takes time to think, while the simulated world goes on."""

import time
from collections.abc import Iterator
from typing import Annotated, Any, Literal

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from laploop.configuration import Field, configuration
from laploop.envs.loop.timing.config import NONE, Computation
from laploop.envs.loop.timing.latency import MeasuredLatency, measured_ns
from laploop.envs.tasks.task_env import TaskEnv
from laploop.errors import InvalidValueError, SimulationError

Action = NDArray[np.float32]
Step = tuple[dict[str, Any], float, bool, bool, dict[str, Any]]

_STREAM = 2670
"""Sets the random think times apart from what else a seed decides."""


@configuration
class AsyncPolicyConfig:
    """How long a policy thinks, and what the arm does meanwhile."""

    think: Computation = NONE
    """From an observation to the actions computed from it; rounded up to whole control ticks."""
    stale: Literal["hold", "zero"] = "hold"
    """What acts when a chunk of actions is used up before the next has arrived: its last action, or zero."""
    chunk_begins: Literal["arrival", "observation"] = "arrival"
    """Whether the first action of a chunk is meant for the tick at which it arrives, or for that of the observation, so that
    those whose tick has passed are skipped."""
    ticks: Annotated[int, Field(ge=1, le=1000)] = 1
    """Control ticks from one observation to the next, unless thinking takes longer."""


class AsyncPolicy(gym.Wrapper[dict[str, Any], Action, dict[str, Any], Action]):
    """Runs a task while its policy thinks.

    In a plain environment time stands still until the action is there, so that asynchronous inference, action chunking and
    what they gain cannot be tried (which users of lerobot ask for in its issue 2670). Here the policy is given an observation
    at some tick; the action that `step` then takes begins to act as many ticks later as the policy has thought. Until then the
    previous one acts. With more to come than one tick, `step` returns the sum of the ticks' rewards and the newest observation,
    from which the policy thinks on at once.

    `step` also takes a chunk, (n, *action), which is played an action a tick. `info` has, besides what the task has,

    - `think_ms`: how long the policy has thought about the action given to this step;
    - `late_ticks`: the same in control ticks, rounded up;
    - `action_age_ms`: at the begin of the last tick, the age of the observation from which the action in it was computed; None
      if there was no such action yet.
    """

    def __init__(self, env: gym.Env[dict[str, Any], Action], config: AsyncPolicyConfig | None = None) -> None:
        """Wrap the environment of a task.

        Raises:
            InvalidValueError: If it is something else.
        """
        super().__init__(env)
        task = env.unwrapped
        if not isinstance(task, TaskEnv):
            raise InvalidValueError("env", type(task).__name__, "the environment of a laploop task")
        self._task: TaskEnv[Any] = task
        self._config = config or AsyncPolicyConfig()
        self._rng = np.random.default_rng()
        self._observed_ns: int | None = None
        self.think_ns: list[int] = []
        """Think times of the episode, one a step; as a trace, they repeat an episode in which they were measured."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict[str, Any], dict[str, Any]]:
        """Reset the environment; until the first action arrives, the action is zero."""
        observation, info = self.env.reset(seed=seed, options=options)
        if seed is not None:
            self._rng = np.random.default_rng((int(seed), _STREAM))
        think = self._config.think
        self._samples: Iterator[int] | None = None if isinstance(think, MeasuredLatency) else think.samples_ns(self._rng)
        self.think_ns = []
        self._chunk = self._no_action()[None]
        self._played = 0
        self._chunk_observed_ns: int | None = None
        self._observed()
        return observation, info | {"think_ms": None, "late_ticks": None, "action_age_ms": None}

    def step(self, action: Action) -> Step:
        """Let the policy's actions arrive when it has thought of them, and run until it is given the next observation.

        Args:
            action: An action, or a chunk of them, (n, *action).

        Raises:
            InvalidValueError: If it is neither.
            SimulationError: If no episode is running.
        """
        if self._observed_ns is None:
            raise SimulationError("no episode is running; call reset() first")
        chunk = self._as_chunk(action)
        think_ns = measured_ns(time.perf_counter() - self._returned_s) if self._samples is None else next(self._samples)
        self.think_ns.append(think_ns)
        late = -(-think_ns // self._task.config.loop.control_ns)
        total, done = 0.0, False
        for tick in range(max(late, self._config.ticks)):
            if tick == late:
                self._adopt(chunk, late)
            age_ms = None if self._chunk_observed_ns is None else (self._now_ns() - self._chunk_observed_ns) * 1e-6
            observation, reward, terminated, truncated, info = self.env.step(self._next_action())
            total += float(reward)
            if done := terminated or truncated:
                break
        if not done and late >= self._config.ticks:
            self._adopt(chunk, late)
        info = info | {"think_ms": think_ns * 1e-6, "late_ticks": late, "action_age_ms": age_ms}
        self._observed()
        return observation, total, terminated, truncated, info

    def _adopt(self, chunk: Action, late: int) -> None:
        """Begin to play a chunk that was computed from the observation of the last `step`."""
        self._chunk, self._chunk_observed_ns = chunk, self._observed_ns
        self._played = late if self._config.chunk_begins == "observation" else 0

    def _next_action(self) -> Action:
        played, self._played = self._played, self._played + 1
        if played < len(self._chunk):
            return np.asarray(self._chunk[played])
        return np.asarray(self._chunk[-1]) if self._config.stale == "hold" else self._no_action()

    def _as_chunk(self, action: Action) -> Action:
        shape = self._no_action().shape
        chunk = np.asarray(action)
        if chunk.shape == shape:
            return chunk[None].copy()
        if chunk.shape[1:] != shape or chunk.ndim != len(shape) + 1 or not len(chunk):
            raise InvalidValueError("shape of the action", chunk.shape, f"{shape}, or (n, {', '.join(map(str, shape))})")
        return chunk.copy()

    def _no_action(self) -> Action:
        return np.zeros(self.env.action_space.shape or (), np.float32)

    def _observed(self) -> None:
        """Note that the policy is given an observation now."""
        self._observed_ns = self._now_ns()
        self._returned_s = time.perf_counter()

    def _now_ns(self) -> int:
        return self._task.loop.now_ns
