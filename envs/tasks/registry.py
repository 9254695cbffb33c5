"""The tasks by name: one entry each, from which everything else about a task is found.

Nothing heavy is loaded before a task is used. Other packages add theirs by an entry point of the group `laploop.tasks`
that names a `TaskSpec`.
"""

import re
from dataclasses import dataclass, fields
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

from laploop.envs.tasks.criteria import Criterion
from laploop.errors import InvalidValueError
from laploop.registry import Registry

if TYPE_CHECKING:
    from laploop.envs.tasks.task_config import TaskConfig
    from laploop.envs.tasks.task_env import TaskEnv


@dataclass(frozen=True, kw_only=True)
class TaskSpec:
    """A task: its environment, its configuration, the controller that solves it, and what counts.

    How the tissue moves, how long an episode lasts, and what counts as a success are the defaults of the configuration.
    """

    environment: "str | type[TaskEnv[Any]]"
    """The class, or where it is: `module:Class`."""
    config: "str | type[TaskConfig]"
    """The class, or where it is; its field `kind` has the task's name as default."""
    controller: str
    """The scripted controller, by its name in `laploop.control.controllers.registry`."""
    criteria: tuple[Criterion, ...] = ()
    """What is measured over many episodes."""

    @property
    def environment_class(self) -> "type[TaskEnv[Any]]":
        """The environment, imported when it is first needed."""
        found: type[TaskEnv[Any]] = _resolved(self.environment)
        return found

    @property
    def config_class(self) -> "type[TaskConfig]":
        """The configuration, imported when it is first needed."""
        found: type[TaskConfig] = _resolved(self.config)
        return found

    @property
    def holds(self) -> bool:
        """Whether an episode ends as a success once something was held for `success_hold_s`."""
        return "success_hold_s" in {field.name for field in fields(self.config_class)}


_CONFIGS = "laploop.envs.tasks.configs"

TASKS: Registry[TaskSpec] = Registry(
    "task",
    "laploop.tasks",
    {
        "reach": TaskSpec(
            environment="laploop.envs.tasks.reach:ReachEnv",
            config=f"{_CONFIGS}:ReachConfig",
            controller="reach",
            criteria=(
                Criterion(name="success", column="success", statistic="mean", at_least=0.95),
                Criterion(name="final error", column="final_error_mm", unit="mm", statistic="mean"),
            ),
        ),
        "track": TaskSpec(
            environment="laploop.envs.tasks.track:TrackEnv",
            config=f"{_CONFIGS}:TrackConfig",
            controller="track",
            criteria=(
                Criterion(name="RMS error along the normal", column="normal_rms_mm", unit="mm", statistic="rms", at_most=1.0),
                Criterion(name="RMS error across it", column="lateral_rms_mm", unit="mm", statistic="rms"),
            ),
        ),
        "palpate": TaskSpec(
            environment="laploop.envs.tasks.palpate:PalpateEnv",
            config=f"{_CONFIGS}:PalpateConfig",
            controller="palpate",
            criteria=(
                Criterion(name="success", column="success", statistic="mean"),
                Criterion(name="share of the hold time in the band", column="in_band_share", statistic="min", at_least=0.95),
                Criterion(name="force over the last hold time", column="force_mean_n", unit="N", statistic="mean"),
            ),
        ),
        "scan": TaskSpec(
            environment="laploop.envs.tasks.scan:ScanEnv",
            config=f"{_CONFIGS}:ScanConfig",
            controller="scan",
            criteria=(
                Criterion(name="RMS of the stand-off", column="standoff_rms_mm", unit="mm", statistic="rms", at_most=0.7),
                Criterion(name="incidence, mean", column="incidence_mean_deg", unit="deg", statistic="mean"),
                Criterion(name="incidence, 95th percentile of the worst", column="incidence_p95_deg", unit="deg", at_most=10.0),
                Criterion(name="share of the scan within 10 deg", column="incidence_within_share", statistic="mean"),
                Criterion(name="length of the path", column="path_length_mm", unit="mm", statistic="min", at_least=59.5),
                Criterion(name="share of the path scanned", column="path_progress", statistic="min", at_least=1.0),
            ),
        ),
        "look": TaskSpec(
            environment="laploop.envs.tasks.look:LookEnv",
            config=f"{_CONFIGS}:LookConfig",
            controller="look",
            criteria=(
                Criterion(
                    name="offset from the middle, greatest", column="centre_share_max", unit="of the width", at_most=0.05
                ),
                Criterion(
                    name="the same, mean 95th percentile", column="centre_share_p95", unit="of the width", statistic="mean"
                ),
                Criterion(
                    name="error of the working distance, greatest", column="distance_error_max_mm", unit="mm", at_most=5.0
                ),
                Criterion(name="the same, mean 95th percentile", column="distance_error_p95_mm", unit="mm", statistic="mean"),
            ),
        ),
    },
)
"""In the order in which the tasks are listed to users."""


def environment_id(task: str) -> str:
    """Return the id under which Gymnasium knows a task, such as `laploop/Reach-v0`."""
    return f"laploop/{re.sub(r'[^0-9A-Za-z]', '', task.title())}-v0"


def task_spec(task: str) -> TaskSpec:
    """Return the entry of a task.

    Raises:
        UnknownNameError: If there is no such task.
        InvalidValueError: If the name stands for something else.
    """
    spec: object = TASKS.get(task)
    if not isinstance(spec, TaskSpec):
        raise InvalidValueError("task", task, f"the name of a TaskSpec, not of a {type(spec).__name__}")
    return spec


def default_config(task: str, **changes: Any) -> "TaskConfig":
    """Return the default configuration of a task, with changes.

    Raises:
        LaploopError: If there is no such task, or a change is not allowed.
    """
    # A task that is known by its place alone is found there again.
    place: dict[str, Any] = {"kind": task} if ":" in task else {}
    return task_spec(task).config_class(**place, **changes)


def make_environment(task: str, **keywords: Any) -> "TaskEnv[Any]":
    """Make the environment of a task, as `gymnasium.make` does.

    Raises:
        UnknownNameError: If there is no such task.
    """
    return task_spec(task).environment_class(**keywords)


def _resolved(place: Any) -> Any:
    return resolve_name(place) if isinstance(place, str) else place
