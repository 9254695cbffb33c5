"""The palpation task: a constant light force on a point of the tissue."""

from collections import deque
from typing import ClassVar

import numpy as np
from gymnasium import spaces

from laploop.envs.tasks.configs import PalpateConfig
from laploop.envs.tasks.measures import Samples, nearness
from laploop.envs.tasks.observations import Observation, bounded
from laploop.envs.tasks.steppable_env import Info
from laploop.envs.tasks.task_env import TaskEnv


class PalpateEnv(TaskEnv[PalpateConfig]):
    """Press on the target with 0.5 N, within 0.1 N, and hold that for 3 s.

    The force of a tick is the mean of its magnitude over the control period's physics steps, from the simulator's state. It
    counts while the tip is within 5 mm of an ideal touch of the material target point.

    ## Action and observation

    Those of `laploop.envs.tasks.actions` and `laploop.envs.tasks.observations`, and `held_share`, `Box(0, 1, (1,))`: the
    fraction of the last 3 s in which the force was in its band.

    ## Reward

    `distance` (minus tanh of the distance from an ideal touch over 20 mm), `band` (1 while the force is in its band),
    `deviation` (minus the force's distance from 0.5 N over 0.5 N, at most 1, while the tip is near), `force`, `effort`,
    `success`, `harm` (`PalpateRewardWeights`).

    ## End

    Terminated with `success` once the force was in its band for 95 % of the last 3 s; with `force` above 2 N; with `rcm`
    above 5 mm. Truncated with `time` after `max_seconds`.

    ## Info

    Besides the keys of every task: `mean_force_n`, `in_band`, `held_share`.
    """

    config_type: ClassVar[type[PalpateConfig]] = PalpateConfig

    def extra_spaces(self) -> dict[str, spaces.Box]:
        """Return the space of the held fraction."""
        return {"held_share": spaces.Box(0.0, 1.0, (1,), np.float32)}

    def extra_observation(self) -> Observation:
        """Return the held fraction."""
        return {"held_share": bounded([self._held_share], 0.0, 1.0)}

    def measure(self, *, begin: bool) -> None:
        """Measure whether the force is in its band, and for what fraction of the hold time it has been."""
        config = self.config
        self._error_mm = self.target_error_mm()
        near = self._error_mm <= config.max_miss_m * 1e3
        self._near = near
        force = self.loop.mean_force_n
        self._in_band = near and abs(force - config.force_n) <= config.tolerance_n
        ticks = max(1, round(config.success_hold_s / config.loop.control_s))
        if begin:
            self._band: deque[bool] = deque([False] * ticks, maxlen=ticks)
            self._forces: deque[float] = deque(maxlen=ticks)
            self._best_share = 0.0
            self._reached = False
            self._since_reached = Samples()
        else:
            self._band.append(self._in_band)
            self._reached = self._reached or self._in_band
            if self._reached:
                self._since_reached.add(float(self._in_band))
            self._forces.append(force)
        self._held_share = sum(self._band) / ticks
        self._best_share = max(self._best_share, self._held_share)

    def is_assessed(self) -> bool:
        """Return whether the tip is near the target and presses."""
        return self._near and self.loop.mean_force_n > 0.0

    def ended_by(self) -> str | None:
        """Return `success` once the force has been held."""
        return "success" if self._held_share >= self.config.hold_share else None

    def reward_terms(self) -> dict[str, float]:
        """Return distance, whether the force is in its band, and its deviation from the middle of it."""
        deviation = min(1.0, abs(self.loop.mean_force_n - self.config.force_n) / self.config.force_n)
        return {
            "distance": nearness(self._error_mm, 20.0),
            "band": float(self._in_band),
            "deviation": -deviation if self._near else 0.0,
        }

    def task_info(self) -> Info:
        """Return distance and force."""
        return {
            "target_error_mm": self._error_mm,
            "mean_force_n": self.loop.mean_force_n,
            "in_band": self._in_band,
            "held_share": self._held_share,
        }

    def metrics(self) -> dict[str, float | None]:
        """Return the held fractions, and the mean and spread of the force over the last hold time."""
        return {
            "held_share_best": self._best_share,
            # Unlike the best, this counts every tick from the first one in the band to the end.
            "in_band_share": self._since_reached.mean(),
            "force_mean_n": float(np.mean(self._forces)) if self._forces else None,
            "force_std_n": float(np.std(self._forces)) if self._forces else None,
        }
