"""A delay that differs from episode to episode."""

from typing import Any, Literal, get_args

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs

from laploop.envs.loop.timing.latency import LONGEST_MS, ConstantLatency, LatencyModel
from laploop.envs.tasks.task_config import DEPTH_MODES, STRIPE_MODES
from laploop.envs.wrappers.chain_state import StatefulWrapper
from laploop.errors import InvalidValueError, UnknownNameError

DelayedStage = Literal["transfer", "service", "pipeline", "transport"]
"""A stage of `TimingConfig`: camera to perception, perception, perception to consumers, controllers to arm."""

_STREAM = 1507
"""Sets the delays apart from what else a seed decides."""


class DelayRandomization(StatefulWrapper):
    """Draws the time that one stage of the loop takes, for each episode anew; within the episode it is constant.

    So a policy learns to cope with a delay that it does not know beforehand, as with the domain randomisation of other
    quantities. The time replaces the stage's own of the configuration, and wins over one that the environment's randomisation
    draws. `info["delay_ms"]` tells it.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        delay: LatencyModel | tuple[float, float] = (0.0, 120.0),
        stage: DelayedStage = "transfer",
    ) -> None:
        """Wrap an environment.

        Args:
            env: That of a task.
            delay: A model from which one time an episode is drawn, or two bounds in ms between which all are as likely.
            stage: What takes that long. Images are delayed by `transfer` alone, depth also by `service` (which then drops
                frames that come while it is busy) and `pipeline`, and everything by `transport`, on the way to the arm.

        Raises:
            InvalidValueError: If the bounds are no times in order, or the stage delays nothing that is observed.
            UnknownNameError: If there is no such stage.
        """
        RecordConstructorArgs.__init__(self, delay=delay, stage=stage)
        super().__init__(env)
        if stage not in get_args(DelayedStage):
            raise UnknownNameError("stage", stage, get_args(DelayedStage))
        config = self.task_env.config
        mode = config.observation_mode
        delaying = ["transport"]
        if mode in DEPTH_MODES or config.action_mode == "residual":
            delaying += ["transfer", "service", "pipeline"]
        elif mode in STRIPE_MODES:
            delaying += ["transfer"]
        if stage not in delaying:
            allowed = f"{', '.join(delaying)}: the others delay nothing in observations of the mode {mode!r}"
            raise InvalidValueError("stage", stage, allowed)
        if not hasattr(delay, "samples_ns") and not _are_bounds(delay):
            raise InvalidValueError("delay", delay, f"a latency model, or bounds in ms, 0 <= low <= high <= {LONGEST_MS:g}")
        self._delay = delay
        self._stage = stage
        self._rng = np.random.default_rng()
        self._delay_ms = 0.0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Draw a delay and begin an episode; a seed decides this delay and those that follow."""
        if isinstance(seed, int) and seed >= 0:
            self._rng = np.random.default_rng((seed, _STREAM))
        self._delay_ms = self._drawn_ms()
        # The reset may make another loop, which takes this over.
        loop = self.task_env.loop
        loop.timing_changes = {**loop.timing_changes, self._stage: ConstantLatency(latency_ms=self._delay_ms)}
        observation, info = self.env.reset(seed=seed, options=options)
        return observation, info | {"delay_ms": self._delay_ms}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step, and tell the delay."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, reward, terminated, truncated, info | {"delay_ms": self._delay_ms}

    def _drawn_ms(self) -> float:
        if isinstance(self._delay, tuple):
            return float(self._rng.uniform(*self._delay))
        return next(self._delay.samples_ns(self._rng)) * 1e-6


def _are_bounds(delay: object) -> bool:
    return (
        isinstance(delay, tuple)
        and len(delay) == 2
        and all(isinstance(bound, int | float) for bound in delay)
        and 0.0 <= delay[0] <= delay[1] <= LONGEST_MS
    )
