"""The reach task behind Gymnasium's interface."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

from laploop.envs.tasks.reach_rewards import ReachRewardWeights, reach_reward_terms
from laploop.envs.tasks.rewards import weighted
from laploop.envs.tasks.task_config import TaskConfig
from laploop.envs.tasks.task_env import Info, TaskEnv


@dataclass(frozen=True, kw_only=True)
class ReachConfig(TaskConfig):
    """What the reach task asks, and in which theatre."""

    rewards: ReachRewardWeights = field(default_factory=ReachRewardWeights)
    success_radius_m: float = 0.0015
    success_hold_s: float = 0.3

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            UnknownNameError: If a mode has an unknown name.
            InvalidValueError: If a value is not positive.
        """
        super().__post_init__()
        self.check_positive("success_radius_m", "success_hold_s")


class ReachEnv(TaskEnv[ReachConfig]):
    """Bring the tip of the instrument onto a point of the tissue that was chosen in the first frame.

    A touch is ideal when the tip, the centre of the probe's ball end, lies one ball radius above the target along the
    surface's normal; the distance from there is the target error.

    ## Action and observation

    Those of `laploop.envs.tasks.actions` and `laploop.envs.tasks.observations`: by default the tip's velocity, and everything.

    ## Reward

    Sum of the named terms in `info["reward_terms"]`: `distance`, `progress`, `contact`, `force`, `effort`, `success`,
    `harm` (`ReachRewardWeights`).

    ## End

    Terminated with `terminated_by` = `success` once the error has stayed below 1.5 mm for 0.3 s; with `force` above 5 N;
    with `rcm` when a shaft is more than 5 mm off its trocar. Truncated with `time` after `max_seconds`.
    """

    task: ClassVar[str] = "reach"

    @classmethod
    def default_config(cls) -> ReachConfig:
        """Return the task as it is by default."""
        return ReachConfig()

    def target_error_mm(self) -> float:
        """Return the distance of the tip from an ideal touch of the target."""
        return self.touch_error_mm()

    def measure(self, *, begin: bool) -> None:
        """Measure the distance, and for how long it has been small enough."""
        error_mm = self.target_error_mm()
        self._previous_error_mm: float = error_mm if begin else self._error_mm
        self._error_mm: float = error_mm
        within = not begin and error_mm <= self.config.success_radius_m * 1e3
        self._held_ns: int = self._held_ns + self.config.loop.rates.control_ns if within else 0

    def ended_by(self) -> str | None:
        """Return `success` once the tip has been held on the target."""
        return "success" if self._held_ns >= round(self.config.success_hold_s * 1e9) else None

    def reward_terms(self, effort: float, *, succeeded: bool, harmed: bool) -> dict[str, float]:
        """Return the weighted terms of `laploop.envs.tasks.reach_rewards`."""
        terms = reach_reward_terms(
            error_mm=self._error_mm,
            previous_error_mm=self._previous_error_mm,
            contact_force_n=self.loop.max_force_n,
            alarm_force_n=self.config.alarm_force_n,
            action_fraction=effort,
            succeeded=succeeded,
            harmed=harmed,
        )
        return weighted(terms, self.config.rewards)

    def task_info(self) -> Info:
        """Return the target error."""
        return {"target_error_mm": self._error_mm}

    def assessed(self, infos: Sequence[Info]) -> Sequence[Info]:
        """Return the final hold: before it, the distance still to go says nothing about accuracy."""
        return infos[-max(1, round(self.config.success_hold_s / self.config.loop.rates.control_s)) :]
