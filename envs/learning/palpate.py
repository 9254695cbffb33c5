"""The palpation task for learners."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from laploop.envs.learning.learner_env import LearnerEnv


class PalpateLearnerEnv(LearnerEnv):
    """Press on a point of the tissue with 0.5 N, within 0.1 N, and hold that for 3 s.

    ## Action space

    As in `LearnerEnv`.

    ## Observation space

    As in `LearnerEnv`; after `target_pixel` come:

    | entry | size | in | scaled by |
    |---|---|---|---|
    | `held_share` | 1 | every | 0 to 1 as -1 to 1 |

    ## Rewards

    As in `LearnerEnv`; terms of the task's own:

    | term | over an episode |
    |---|---|
    | `approach` | `rewards.approach` of the distance from an ideal touch at the end, minus that at the begin |
    | `press` | the potential gained: half of 1 minus the force's distance from 0.5 N over 0.5 N, within 5 mm of the touch |
    | `hold` | how much longer the force was held within its band, over the last 3 s, than at the begin |
    | `time` | -0.5 x the share of the episode's time that has passed |

    ## Starting state

    The tip is 45 to 65 mm away from the target and touches nothing.

    ## Episode end

    Terminated as a success once the force was in its band for 95 % of the last 3 s, or by harm: above 2 N, or a shaft more than
    5 mm off its trocar. Truncated after 15 s, 375 steps.

    ## Arguments

    As in `LearnerEnv`.

    ## Version history

    As in `LearnerEnv`.
    """

    task_name: ClassVar[str | None] = "palpate"

    def dense_terms(self, before: Mapping[str, Any], after: Mapping[str, Any], fraction: float) -> dict[str, Any]:
        """Return approach, press, hold and time."""
        return {
            **super().dense_terms(before, after, fraction),
            "press": self._press(after) - self._press(before),
            "hold": after["held_share"] - before["held_share"],
        }

    def _press(self, measured: Mapping[str, Any]) -> Any:
        """Return the potential of the force on the target."""
        config = self.task_env.config
        off = np.minimum(1.0, np.abs(measured["mean_force_n"] - config.force_n) / config.force_n)
        near = measured["target_error_mm"] <= config.max_miss_m * 1e3
        return np.where(near, 0.5 * (1.0 - off), 0.0)
