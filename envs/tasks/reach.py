"""The reach task behind Gymnasium's interface."""

from collections.abc import Sequence
from typing import ClassVar

from laploop.envs.tasks.configs import ReachConfig
from laploop.envs.tasks.measures import nearness
from laploop.envs.tasks.steppable_env import Info
from laploop.envs.tasks.task_env import TaskEnv


class ReachEnv(TaskEnv[ReachConfig]):
    """Bring the tip of the instrument onto a point of the tissue that was chosen in the first frame.

    A touch is ideal when the tip, the centre of the probe's ball end, lies one ball radius above the target along the
    surface's normal; the distance from there is the target error.

    ## Action and observation

    Those of `laploop.envs.tasks.actions` and `laploop.envs.tasks.observations`: by default the tip's velocity, and everything.

    ## Reward

    Sum of the named terms in `info["reward_terms"]`, weighted by `ReachRewardWeights`: `distance` (minus tanh of the error over
    20 mm), `progress` (mm gained, over 20 mm), `contact` (1 while the tip touches within the success radius), and `force`,
    `effort`, `success`, `harm` as in every task.

    ## End

    Terminated with `terminated_by` = `success` once the error has stayed below 1.5 mm for 0.3 s; with `force` above 5 N;
    with `rcm` when a shaft is more than 5 mm off its trocar. Truncated with `time` after `max_seconds`.
    """

    config_type: ClassVar[type[ReachConfig]] = ReachConfig

    def measure(self, *, begin: bool) -> None:
        """Measure the distance, and for how long it has been small enough."""
        error_mm = self.target_error_mm()
        self._previous_error_mm: float = error_mm if begin else self._error_mm
        self._error_mm: float = error_mm
        within = not begin and error_mm <= self.config.success_radius_m * 1e3
        self._held_ns: int = self._held_ns + self.config.loop.control_ns if within else 0

    def ended_by(self) -> str | None:
        """Return `success` once the tip has been held on the target."""
        return "success" if self._held_ns >= round(self.config.success_hold_s * 1e9) else None

    def reward_terms(self) -> dict[str, float]:
        """Return distance, progress and contact."""
        touching = self.loop.max_force_n > 0.0 and self._error_mm < self.config.success_radius_m * 1e3
        return {
            "distance": nearness(self._error_mm, 20.0),
            "progress": (self._previous_error_mm - self._error_mm) / 20.0,
            "contact": float(touching),
        }

    def task_info(self) -> Info:
        """Return the target error."""
        return {"target_error_mm": self._error_mm}

    def assessed(self, infos: Sequence[Info]) -> Sequence[Info]:
        """Return the final hold: before it, the distance still to go says nothing about accuracy."""
        return infos[-max(1, round(self.config.success_hold_s / self.config.loop.control_s)) :]
