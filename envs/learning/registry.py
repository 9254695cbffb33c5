"""How Gymnasium knows the tasks for learners; nothing heavy is loaded."""

from dataclasses import dataclass

from gymnasium.envs.registration import register

from laploop.envs.tasks.registry import environment_id


@dataclass(frozen=True, kw_only=True)
class LearnerSpec:
    """What Gymnasium's entry of a task says."""

    entry_point: str
    max_episode_steps: int | None = None
    """The task's `max_seconds` in steps of 40 ms."""
    reward_threshold: float | None = None
    """Dense return from which the task counts as learned: 90 % of the scripted controller's mean return
    (docs/results/learner-returns.json)."""


LEARNERS: dict[str, LearnerSpec] = {
    "reach": LearnerSpec(
        entry_point="laploop.envs.learning.reach:ReachLearnerEnv", max_episode_steps=250, reward_threshold=2.1
    ),
    "track": LearnerSpec(
        entry_point="laploop.envs.learning.track:TrackLearnerEnv", max_episode_steps=500, reward_threshold=3.1
    ),
    "palpate": LearnerSpec(
        entry_point="laploop.envs.learning.palpate:PalpateLearnerEnv", max_episode_steps=375, reward_threshold=2.6
    ),
    "scan": LearnerSpec(entry_point="laploop.envs.learning.scan:ScanLearnerEnv", max_episode_steps=750, reward_threshold=3.2),
    "look": LearnerSpec(entry_point="laploop.envs.learning.look:LookLearnerEnv", max_episode_steps=250, reward_threshold=2.5),
}
"""By task."""


def learner_spec(task: str) -> LearnerSpec:
    """Return what Gymnasium's entry of a task says; one that has no environment of its own gets what all of them share."""
    return LEARNERS.get(task) or LearnerSpec(entry_point="laploop.envs.learning.learner_env:LearnerEnv")


def register_learner(task: str) -> None:
    """Register a task for learners."""
    spec = learner_spec(task)
    register(
        environment_id(task, 1),
        entry_point=spec.entry_point,
        vector_entry_point="laploop.envs.batch.making:make_learner_vector",
        kwargs={"task": task},
        max_episode_steps=spec.max_episode_steps,
        reward_threshold=spec.reward_threshold,
    )
