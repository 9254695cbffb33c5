"""The tracking task for learners."""

from collections.abc import Mapping
from typing import Any, ClassVar

from laploop.envs.learning.learner_env import LearnerEnv
from laploop.envs.learning.rewards import approach, closeness


class TrackLearnerEnv(LearnerEnv):
    """Hold the ball end of the instrument 3 mm above a point of tissue that breathes and beats.

    ## Action space

    As in `LearnerEnv`.

    ## Observation space

    As in `LearnerEnv`.

    ## Rewards

    As in `LearnerEnv`; terms of the task's own:

    | term | over an episode |
    |---|---|
    | `approach` | `rewards.approach` of the distance from the place above the target at the end, minus that at the begin |
    | `accuracy` | the mean of 1/2 exp(-error along the normal over 1 mm) + 1/2 exp(-distance over 5 mm) |

    ## Starting state

    The tip is 45 to 65 mm away from its place; the tissue is in motion.

    ## Episode end

    Truncated after 20 s, 500 steps, as a success if the root mean square error along the normal was at most 1 mm from 10 s on.
    Terminated by harm alone: above 5 N, or a shaft more than 5 mm off its trocar.

    ## Arguments

    As in `LearnerEnv`.

    ## Version history

    As in `LearnerEnv`.
    """

    task_name: ClassVar[str | None] = "track"

    def dense_terms(self, before: Mapping[str, Any], after: Mapping[str, Any], fraction: float) -> dict[str, Any]:
        """Return approach and accuracy."""
        along = closeness(after["normal_error_mm"], 1.0)
        accuracy = 0.5 * along + 0.5 * closeness(after["target_error_mm"], 5.0)
        gained = approach(after["target_error_mm"]) - approach(before["target_error_mm"])
        return {"approach": gained, "accuracy": fraction * accuracy}
