"""What `gymnasium.make_vec` calls for our ids."""

from collections.abc import Mapping, Sequence
from functools import partial
from pkgutil import resolve_name
from typing import Any

from gymnasium.vector import AutoresetMode

from laploop.envs.batch.stepper import checked_count
from laploop.envs.batch.vector_env import MOST_ENVIRONMENTS, TheatreVectorEnv
from laploop.envs.learning.registry import learner_spec
from laploop.envs.tasks.registry import task_spec
from laploop.envs.tasks.steppable_env import SteppableEnv
from laploop.errors import InvalidValueError


def make_task_vector(*, num_envs: int, task: str, **keywords: Any) -> TheatreVectorEnv:
    """Make many environments of a task as `TaskEnv` is; keywords and errors as for `make_vector`."""
    task_spec(task)
    return make_vector("laploop.envs.tasks.registry:make_environment", num_envs=num_envs, task=task, **keywords)


def make_learner_vector(*, num_envs: int, task: str, **keywords: Any) -> TheatreVectorEnv:
    """Make many environments of a task as `LearnerEnv` is; keywords and errors as for `make_vector`."""
    task_spec(task)
    return make_vector(learner_spec(task).entry_point, num_envs=num_envs, task=task, **keywords)


def make_vector(
    entry_point: str,
    *,
    num_envs: int,
    each: Sequence[Mapping[str, Any]] | None = None,
    autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
    max_episode_steps: int | None = None,
    workers: int | None = None,
    threads: int = 1,
    **keywords: Any,
) -> TheatreVectorEnv:
    """Make many environments.

    Args:
        entry_point: What makes one, `module:attribute`.
        num_envs: How many.
        each: Keywords of each environment on top of those that all have: other tissues, optics, latencies.
        autoreset_mode: See `TheatreVectorEnv`, as the next three.
        max_episode_steps: See there.
        workers: See there.
        threads: See there.
        keywords: What all environments are made with.

    Raises:
        UnknownNameError: If an environment knows no such keyword.
        InvalidValueError: If a number or a keyword is not allowed, or environments differ in their spaces.
        WorkerError: If a process cannot be started.
    """
    count = checked_count("num_envs", num_envs, MOST_ENVIRONMENTS)
    own = [{}] * count if each is None else list(each)
    if len(own) != count:
        raise InvalidValueError("length of each", len(own), f"{count}, keywords an environment")
    return TheatreVectorEnv(
        [partial(_environment, entry_point, {**keywords, **one}) for one in own],
        autoreset_mode=autoreset_mode,
        max_episode_steps=max_episode_steps,
        workers=workers,
        threads=threads,
    )


def _environment(entry_point: str, keywords: dict[str, Any]) -> SteppableEnv:
    made: SteppableEnv = resolve_name(entry_point)(**keywords)
    return made
