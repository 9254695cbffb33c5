"""The looking task for learners."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from laploop.arrays import Array
from laploop.envs.learning.learner_env import LearnerEnv
from laploop.envs.learning.rewards import approach, closeness
from laploop.perception.geometry import invert_transform, transform_points


class LookLearnerEnv(LearnerEnv):
    """Move the scope under its trocar so that a moving target stays in the middle of the image, 85 mm away.

    ## Action space

    As in `LearnerEnv`.

    ## Observation space

    As in `LearnerEnv`; after `target_pixel` come:

    | entry | size | in | scaled by |
    |---|---|---|---|
    | `marker_pixel` | 2 | every | the image to -1 to 1; -1, -1 where it is not seen |
    | `scope_velocity`, `scope_insertion` | 3, 1 | every | 0.06 m/s; 0.05 m from 0.11 m |

    ## Rewards

    As in `LearnerEnv`; terms of the task's own:

    | term | over an episode |
    |---|---|
    | `approach` | `rewards.approach` of the target's distance from its place at the end, minus that at the begin |
    | `accuracy` | the mean of exp(-distance from the middle over 5 % of the width) x exp(-error of the distance over 5 mm) |

    ## Starting state

    The target is 15 to 25 mm away from its place in the view; tissue and stage are in motion.

    ## Episode end

    Truncated after 10 s, 250 steps, as a success if for 95 % of the time from 2 s on the target was within 5 % of the image's
    width of its middle and within 5 mm of the working distance. Terminated by harm alone: above 5 N, or a shaft more than 5 mm
    off its trocar.

    ## Arguments

    As in `LearnerEnv`.

    ## Version history

    As in `LearnerEnv`.
    """

    task_name: ClassVar[str | None] = "look"

    def dense_terms(self, before: Mapping[str, Any], after: Mapping[str, Any], fraction: float) -> dict[str, Any]:
        """Return approach and accuracy."""
        config = self.task_env.config
        centred = closeness(after["centre_share"], config.max_centre_share)
        distant = closeness(after["distance_error_mm"], config.max_distance_error_m * 1e3)
        gained = approach(after["target_error_mm"]) - approach(before["target_error_mm"])
        return {"approach": gained, "accuracy": fraction * centred * distant}

    def to_target(self) -> Array:
        """Return the way from the middle of the view, at the working distance, to the target, (3,), metres."""
        camera_from_world = invert_transform(self.task_env.loop.theatre.world_from_camera())
        target = transform_points(camera_from_world, self.task_env.target_in_world())
        return np.asarray(target - [0.0, 0.0, self.task_env.config.working_distance_m])
