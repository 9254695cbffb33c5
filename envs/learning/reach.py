"""The reach task for learners."""

from typing import ClassVar

from laploop.envs.learning.learner_env import LearnerEnv


class ReachLearnerEnv(LearnerEnv):
    """Bring the tip of the instrument onto a point of the tissue chosen in the first frame, and hold it there for 0.3 s.

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
    | `approach` | `rewards.approach` of the distance from an ideal touch at the end, minus that at the begin |
    | `time` | -0.5 x the share of the episode's time that has passed |
    | `force` | -2 x the share of time that the tip is pressed with 5 N; linear from 2 N on |
    | `speed` | -0.1 x the mean square of the action |
    | `success`, `harm` | 1 once the task is solved, -1 once a safety limit is passed |

    ## Starting state

    The tip is 45 to 65 mm away from the target.

    ## Episode end

    Terminated as a success once the distance has stayed below 1.5 mm for 0.3 s, or by harm: above 5 N, or a shaft more than
    5 mm off its trocar. Truncated after 10 s, 250 steps.

    ## Arguments

    As in `LearnerEnv`.

    ## Version history

    As in `LearnerEnv`.
    """

    task_name: ClassVar[str | None] = "reach"
