"""The reach task for learners."""

from typing import ClassVar

from laploop.envs.learning.learner_env import LearnerEnv


class ReachLearnerEnv(LearnerEnv):
    """Bring the tip of the instrument onto a point of the tissue chosen in the first frame, and hold it there for 0.3 s.

    ## Action space

    As in `LearnerEnv`.

    ## Observation space

    As in `LearnerEnv`.

    ## Rewards

    As in `LearnerEnv`; terms of the task's own:

    | term | over an episode |
    |---|---|
    | `approach` | `rewards.approach` of the distance from an ideal touch at the end, minus that at the begin |
    | `time` | -0.5 x the share of the episode's time that has passed |

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
