"""The tracking task: a constant distance over a point of moving tissue."""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from laploop.assets.shafts import INSTRUMENT
from laploop.envs.tasks.rewards import weighted
from laploop.envs.tasks.task_config import TaskConfig
from laploop.envs.tasks.task_env import Info, TaskEnv
from laploop.envs.theatre.organ_motion import BaseMotion


@dataclass(frozen=True, kw_only=True)
class TrackRewardWeights:
    """What each term counts; a term's value times its weight is what `info["reward_terms"]` shows."""

    distance: float = 1.0
    normal: float = 1.0
    contact: float = 1.0
    force: float = 0.5
    effort: float = 0.02
    success: float = 10.0
    harm: float = 10.0


@dataclass(frozen=True, kw_only=True)
class TrackConfig(TaskConfig):
    """What the tracking task asks, and in which theatre."""

    motion: BaseMotion = field(default_factory=lambda: BaseMotion.named("both"))
    rewards: TrackRewardWeights = field(default_factory=TrackRewardWeights)
    max_seconds: float = 20.0
    standoff_m: float = 0.003
    """Between the ball end and the tissue."""
    settle_s: float = 10.0
    """Until then nothing counts: the tip must get there, and a predictor learn the motion."""
    max_rms_m: float = 0.001
    """Largest root mean square error along the normal of an episode that counts as a success."""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            UnknownNameError: If a mode has an unknown name.
            InvalidValueError: If a value is not positive.
        """
        super().__post_init__()
        self.check_positive("standoff_m", "settle_s", "max_rms_m")


class TrackEnv(TaskEnv[TrackConfig]):
    """Hold the ball end of the instrument 3 mm above a material point of tissue that breathes and beats.

    The tip should lie the stand-off plus the ball's radius above the target along the surface's normal. What counts is the
    error along that normal, as root mean square over the time after `settle_s`.

    ## Action and observation

    Those of `laploop.envs.tasks.actions` and `laploop.envs.tasks.observations`.

    ## Reward

    `distance` (minus tanh of the error over 20 mm), `normal` (minus tanh of the error along the normal over 2 mm), `contact`
    (minus 1 while the tip touches anything), `force`, `effort`, `success`, `harm` (`TrackRewardWeights`).

    ## End

    The duration is fixed: truncated with `time` after `max_seconds`, a success if the error along the normal was at most
    1 mm. Terminated only by harm: `force` above 5 N, `rcm` above 5 mm.

    ## Info

    Besides what every task says: `normal_error_mm` (signed, positive too far away) and `lateral_error_mm`.
    """

    task: ClassVar[str] = "track"

    @classmethod
    def default_config(cls) -> TrackConfig:
        """Return the task as it is by default."""
        return TrackConfig()

    def target_error_mm(self) -> float:
        """Return the distance of the tip from its place above the target."""
        offset, normal, _ = self.target_offset()
        return float(np.linalg.norm(offset - (self.config.standoff_m + INSTRUMENT.tip_radius_m) * normal)) * 1e3

    def measure(self, *, begin: bool) -> None:
        """Split the error into its parts along and across the normal, and add them up once they count."""
        offset, normal, _ = self.target_offset()
        error = (offset - (self.config.standoff_m + INSTRUMENT.tip_radius_m) * normal) * 1e3
        self._error_mm = float(np.linalg.norm(error))
        self._normal_error_mm = float(error @ normal)
        self._lateral_error_mm = float(np.linalg.norm(error - self._normal_error_mm * normal))
        if begin:
            self._normal_errors_mm: list[float] = []
            self._lateral_errors_mm: list[float] = []
        elif self.is_assessed():
            self._normal_errors_mm.append(self._normal_error_mm)
            self._lateral_errors_mm.append(self._lateral_error_mm)

    def is_assessed(self) -> bool:
        """Count what comes after the settling time."""
        return self.loop.now_ns > round(self.config.settle_s * 1e9)

    def solved_in_time(self) -> bool:
        """Say whether the error along the normal has been small enough."""
        errors = self._normal_errors_mm
        return bool(errors) and _rms(errors) <= self.config.max_rms_m * 1e3

    def reward_terms(self, effort: float, *, succeeded: bool, harmed: bool) -> dict[str, float]:
        """Return the weighted terms."""
        terms = {
            "distance": -float(np.tanh(self._error_mm / 20.0)),
            "normal": -float(np.tanh(abs(self._normal_error_mm) / 2.0)),
            "contact": -float(self.loop.max_force_n > 0.0),
            "force": -self.excess_force_n(),
            "effort": -(effort**2),
            "success": float(succeeded),
            "harm": -float(harmed),
        }
        return weighted(terms, self.config.rewards)

    def task_info(self) -> Info:
        """Return the errors."""
        return {
            "target_error_mm": self._error_mm,
            "normal_error_mm": self._normal_error_mm,
            "lateral_error_mm": self._lateral_error_mm,
        }

    def metrics(self) -> dict[str, float | None]:
        """Return the errors' root mean squares after the settling time."""
        seen = bool(self._normal_errors_mm)
        return {
            "normal_rms_mm": _rms(self._normal_errors_mm) if seen else None,
            "normal_max_mm": float(np.abs(self._normal_errors_mm).max()) if seen else None,
            "lateral_rms_mm": _rms(self._lateral_errors_mm) if seen else None,
        }


def _rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
