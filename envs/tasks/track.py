"""The tracking task: a constant distance over a point of moving tissue."""

from typing import ClassVar

import numpy as np

from laploop.assets.shafts import INSTRUMENT
from laploop.envs.tasks.configs import TrackConfig
from laploop.envs.tasks.measures import Samples, nearness
from laploop.envs.tasks.steppable_env import Info
from laploop.envs.tasks.task_env import TaskEnv


class TrackEnv(TaskEnv[TrackConfig]):
    """Hold the ball end of the instrument 3 mm above a material point of tissue that breathes and beats.

    The tip should lie the stand-off plus the ball's radius above the target along the surface's normal. The error along that
    normal is assessed, as root mean square over the time after `settle_s`.

    ## Action and observation

    Those of `laploop.envs.tasks.actions` and `laploop.envs.tasks.observations`.

    ## Reward

    `distance` (minus tanh of the error over 20 mm), `normal` (minus tanh of the error along the normal over 2 mm), `contact`
    (minus 1 while the tip touches anything), `force`, `effort`, `success`, `harm` (`TrackRewardWeights`).

    ## End

    The duration is fixed: truncated with `time` after `max_seconds`, a success if the error along the normal was at most
    1 mm. Terminated only by harm: `force` above 5 N, `rcm` above 5 mm.

    ## Info

    Besides the keys of every task: `normal_error_mm` (signed, positive too far away) and `lateral_error_mm`.
    """

    config_type: ClassVar[type[TrackConfig]] = TrackConfig

    def target_error_mm(self) -> float:
        """Return the distance of the tip from its place above the target."""
        offset, normal, _ = self.target_offset()
        return float(np.linalg.norm(offset - (self.config.standoff_m + INSTRUMENT.tip_radius_m) * normal)) * 1e3

    def measure(self, *, begin: bool) -> None:
        """Split the error into its parts along and across the normal, and keep them once they are assessed."""
        offset, normal, _ = self.target_offset()
        error = (offset - (self.config.standoff_m + INSTRUMENT.tip_radius_m) * normal) * 1e3
        self._error_mm = float(np.linalg.norm(error))
        self._normal_error_mm = float(error @ normal)
        self._lateral_error_mm = float(np.linalg.norm(error - self._normal_error_mm * normal))
        if begin:
            self._normal, self._lateral = Samples(), Samples()
        elif self.is_assessed():
            self._normal.add(self._normal_error_mm)
            self._lateral.add(self._lateral_error_mm)

    def is_assessed(self) -> bool:
        """Return whether the settling time is over."""
        return self.loop.now_ns > round(self.config.settle_s * 1e9)

    def solved_in_time(self) -> bool:
        """Return whether the error along the normal has been small enough."""
        rms = self._normal.rms()
        return rms is not None and rms <= self.config.max_rms_m * 1e3

    def reward_terms(self) -> dict[str, float]:
        """Return distance, error along the normal, and contact."""
        return {
            "distance": nearness(self._error_mm, 20.0),
            "normal": nearness(abs(self._normal_error_mm), 2.0),
            "contact": -float(self.loop.max_force_n > 0.0),
        }

    def task_info(self) -> Info:
        """Return the errors."""
        return {
            "target_error_mm": self._error_mm,
            "normal_error_mm": self._normal_error_mm,
            "lateral_error_mm": self._lateral_error_mm,
        }

    def metrics(self) -> dict[str, float | None]:
        """Return the errors' root mean squares after the settling time."""
        return {
            "normal_rms_mm": self._normal.rms(),
            "normal_max_mm": self._normal.largest(),
            "lateral_rms_mm": self._lateral.rms(),
        }
