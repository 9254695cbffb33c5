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

    As in `LearnerEnv`; entries of the vectors:

    | entry | size | in | scaled by |
    |---|---|---|---|
    | `tip_position`, `tip_velocity` | 3, 3 | every | 0.05 m from (0, 0, 0.09) m; 0.06 m/s |
    | `contact_force` | 3 | every | 2 N |
    | `frame_age` | 1 | every but `state` | 0.1 s |
    | `target_pixel` | 2 | every | the image to -1 to 1 |
    | `to_target` | 3 | `state`, `depth+state` | 0.02 m |
    | `target_normal`, `tissue_velocity`, `true_force` | 3, 3, 3 | the same | 1; 0.06 m/s; 2 N |
    | `target_distance` | 1 | the same | 0.02 m |

    ## Rewards

    `reward="dense"`: the sum of these; `reward="sparse"`: 1 in the step that solves the task, 0 otherwise.

    | term | over an episode |
    |---|---|
    | `approach` | `rewards.approach` of the distance from the place above the target at the end, minus that at the begin |
    | `accuracy` | the mean of 1/2 exp(-error along the normal over 1 mm) + 1/2 exp(-distance over 5 mm) |
    | `force` | -2 x the share of time that the tip is pressed with 5 N; linear from 2 N on |
    | `speed` | -0.1 x the mean square of the action |
    | `success`, `harm` | 1 once the task is solved, -1 once a safety limit is passed |

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
