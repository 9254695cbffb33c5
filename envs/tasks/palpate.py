"""The palpation task: a constant light force on a point of the tissue."""

from collections import deque
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from gymnasium import spaces

from laploop.envs.tasks.observations import Observation, bounded
from laploop.envs.tasks.rewards import weighted
from laploop.envs.tasks.task_config import TaskConfig
from laploop.envs.tasks.task_env import Info, TaskEnv
from laploop.errors import InvalidValueError


@dataclass(frozen=True, kw_only=True)
class PalpateRewardWeights:
    """What each term counts; a term's value times its weight is what `info["reward_terms"]` shows."""

    distance: float = 1.0
    band: float = 1.0
    deviation: float = 0.5
    force: float = 0.5
    effort: float = 0.02
    success: float = 10.0
    harm: float = 10.0


@dataclass(frozen=True, kw_only=True)
class PalpateConfig(TaskConfig):
    """What the palpation task asks, and in which theatre."""

    rewards: PalpateRewardWeights = field(default_factory=PalpateRewardWeights)
    max_seconds: float = 15.0
    harm_force_n: float = 2.0
    """Palpation never needs more, so the episode ends there."""
    alarm_force_n: float = 1.0
    force_n: float = 0.5
    tolerance_n: float = 0.1
    success_hold_s: float = 3.0
    hold_share: float = 0.95
    """Share of the hold time that the force must be in its band."""
    max_miss_m: float = 0.005
    """Largest distance of the tip from an ideal touch of the target at which a force counts."""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            UnknownNameError: If a mode has an unknown name.
            InvalidValueError: If a value is not positive, or the band reaches zero or the harmful force.
        """
        super().__post_init__()
        self.check_positive("force_n", "tolerance_n", "success_hold_s", "max_miss_m")
        if not self.tolerance_n < self.force_n < self.harm_force_n - self.tolerance_n:
            raise InvalidValueError("force_n", self.force_n, "above tolerance_n, and below harm_force_n by more than that")
        if not 0.0 < self.hold_share <= 1.0:
            raise InvalidValueError("hold_share", self.hold_share, "above 0, at most 1")


class PalpateEnv(TaskEnv[PalpateConfig]):
    """Press on the target with 0.5 N, within 0.1 N, and hold that for 3 s.

    The force of a tick is the mean of its magnitude over the control period's physics steps, from the simulator's state. It
    counts while the tip is within 5 mm of an ideal touch of the material target point.

    ## Action and observation

    Those of `laploop.envs.tasks.actions` and `laploop.envs.tasks.observations`, and `held_share`, `Box(0, 1, (1,))`: in which
    share of the last 3 s the force was in its band.

    ## Reward

    `distance` (minus tanh of the distance from an ideal touch over 20 mm), `band` (1 while the force is in its band),
    `deviation` (minus the force's distance from 0.5 N over 0.5 N, at most 1, while the tip is near), `force`, `effort`,
    `success`, `harm` (`PalpateRewardWeights`).

    ## End

    Terminated with `success` once the force was in its band for 95 % of the last 3 s; with `force` above 2 N; with `rcm`
    above 5 mm. Truncated with `time` after `max_seconds`.

    ## Info

    Besides what every task says: `mean_force_n`, `in_band`, `held_share`.
    """

    task: ClassVar[str] = "palpate"

    @classmethod
    def default_config(cls) -> PalpateConfig:
        """Return the task as it is by default."""
        return PalpateConfig()

    def extra_spaces(self) -> dict[str, spaces.Box]:
        """Return the space of the share that has been held."""
        return {"held_share": spaces.Box(0.0, 1.0, (1,), np.float32)}

    def extra_observation(self) -> Observation:
        """Return the share that has been held."""
        return {"held_share": bounded([self._held_share], 0.0, 1.0)}

    def target_error_mm(self) -> float:
        """Return the distance of the tip from an ideal touch of the target."""
        return self.touch_error_mm()

    def measure(self, *, begin: bool) -> None:
        """Look whether the force is in its band, and for which share of the hold time it has been."""
        config = self.config
        self._error_mm = self.target_error_mm()
        near = self._error_mm <= config.max_miss_m * 1e3
        self._near = near
        force = self.loop.mean_force_n
        self._in_band = near and abs(force - config.force_n) <= config.tolerance_n
        ticks = max(1, round(config.success_hold_s / config.loop.rates.control_s))
        if begin:
            self._band: deque[bool] = deque([False] * ticks, maxlen=ticks)
            self._forces: deque[float] = deque(maxlen=ticks)
            self._best_share = 0.0
            self._since_reached: list[bool] = []
        else:
            self._band.append(self._in_band)
            if self._in_band or self._since_reached:
                self._since_reached.append(self._in_band)
            self._forces.append(force)
        self._held_share = sum(self._band) / ticks
        self._best_share = max(self._best_share, self._held_share)

    def is_assessed(self) -> bool:
        """Count the ticks with the tip near the target and pressing."""
        return self._near and self.loop.mean_force_n > 0.0

    def ended_by(self) -> str | None:
        """Return `success` once the force has been held."""
        return "success" if self._held_share >= self.config.hold_share else None

    def reward_terms(self, effort: float, *, succeeded: bool, harmed: bool) -> dict[str, float]:
        """Return the weighted terms."""
        deviation = min(1.0, abs(self.loop.mean_force_n - self.config.force_n) / self.config.force_n)
        terms = {
            "distance": -float(np.tanh(self._error_mm / 20.0)),
            "band": float(self._in_band),
            "deviation": -deviation if self._near else 0.0,
            "force": -self.excess_force_n(),
            "effort": -(effort**2),
            "success": float(succeeded),
            "harm": -float(harmed),
        }
        return weighted(terms, self.config.rewards)

    def task_info(self) -> Info:
        """Return distance and force."""
        return {
            "target_error_mm": self._error_mm,
            "mean_force_n": self.loop.mean_force_n,
            "in_band": self._in_band,
            "held_share": self._held_share,
        }

    def metrics(self) -> dict[str, float | None]:
        """Return the shares held, and the mean and spread of the force over the last hold time."""
        return {
            "held_share_best": self._best_share,
            # Unlike the best, this counts every tick from the first one in the band to the end.
            "in_band_share": float(np.mean(self._since_reached)) if self._since_reached else None,
            "force_mean_n": float(np.mean(self._forces)) if self._forces else None,
            "force_std_n": float(np.std(self._forces)) if self._forces else None,
        }
