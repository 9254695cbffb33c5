"""The scanning task for learners."""

from collections.abc import Mapping
from typing import Any, ClassVar

from laploop.envs.learning.learner_env import LearnerEnv
from laploop.envs.learning.rewards import closeness


class ScanLearnerEnv(LearnerEnv):
    """Lead the ball end of the instrument 3 mm above a line of 60 mm on the tissue that was drawn in the first frame.

    ## Action space

    As in `LearnerEnv`.

    ## Observation space

    As in `LearnerEnv`; after `target_pixel` come:

    | entry | size | in | scaled by |
    |---|---|---|---|
    | `path_pixels`, `path_progress` | 62, 1 | every | the image to -1 to 1; 0 to 1 as -1 to 1 |

    ## Rewards

    As in `LearnerEnv`; terms of the task's own:

    | term | over an episode |
    |---|---|
    | `approach` | `rewards.approach` of the distance from the place above the line at the end, minus that at the begin |
    | `path` | the share of the line scanned; counts half where the stand-off is far off, as exp(-error over 1 mm) |
    | `time` | -0.5 x the share of the episode's time that has passed |

    ## Starting state

    The tip is 45 to 80 mm away from its place above the begin of the line.

    ## Episode end

    Terminated at the end of the line, as a success if the root mean square error of the stand-off was at most 1 mm and the mean
    incidence at most 10 degrees, or by harm: above 5 N, or a shaft more than 5 mm off its trocar. Truncated after 30 s, 750
    steps.

    ## Arguments

    As in `LearnerEnv`.

    ## Version history

    As in `LearnerEnv`.
    """

    task_name: ClassVar[str | None] = "scan"

    def dense_terms(self, before: Mapping[str, Any], after: Mapping[str, Any], fraction: float) -> dict[str, Any]:
        """Return approach, path and time."""
        scanned = after["path_progress"] - before["path_progress"]
        return {
            **super().dense_terms(before, after, fraction),
            "path": scanned * (0.5 + 0.5 * closeness(after["standoff_error_mm"], 1.0)),
        }
