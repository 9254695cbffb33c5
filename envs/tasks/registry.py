"""The tasks by name: one entry each, from which everything else about a task is found.

Nothing heavy is loaded before a task is used. Other packages add theirs by an entry point of the group `laploop.tasks`
that names a `TaskSpec`.
"""

import re
from dataclasses import dataclass, fields
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Literal, get_type_hints

from laploop.errors import InvalidValueError
from laploop.registry import Registry, call_checked

if TYPE_CHECKING:
    from laploop.envs.tasks.task_config import TaskConfig
    from laploop.envs.tasks.task_env import TaskEnv


Statistic = Literal["mean", "rms", "max", "min"]
"""How the episodes' values become one."""


@dataclass(frozen=True)
class Criterion:
    """One number of many episodes, and its bound, if it has one."""

    name: str
    column: str
    """Of an episode: `success`, `final_error_mm`, ..., or one of the task's metrics."""
    unit: str = ""
    statistic: Statistic = "max"
    at_most: float | None = None
    at_least: float | None = None

    def bar(self) -> str:
        """Return the bound in words; empty without one."""
        unit = f" {self.unit}" if self.unit else ""
        if self.at_most is not None:
            return f"at most {self.at_most:.3g}{unit}"
        return "" if self.at_least is None else f"at least {self.at_least:.3g}{unit}"


@dataclass(frozen=True, kw_only=True)
class TaskSpec:
    """A task: its environment, its configuration, the controller that solves it, and what counts.

    How the tissue moves, how long an episode lasts, and what counts as a success are the defaults of the configuration.
    """

    environment: "str | type[TaskEnv[Any]]"
    """The class, or where it is: `module:Class`."""
    config: "str | type[TaskConfig]"
    """The class, or where it is; its field `kind: str` has the task's name as default."""
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


def _built_in(task: str, *criteria: Criterion) -> TaskSpec:
    name = task.capitalize()
    return TaskSpec(
        environment=f"laploop.envs.tasks.{task}:{name}Env",
        config=f"laploop.envs.tasks.configs:{name}Config",
        controller=task,
        criteria=criteria,
    )


TASKS: Registry[TaskSpec] = Registry(
    "task",
    "laploop.tasks",
    {
        "reach": _built_in(
            "reach",
            Criterion("success", "success", "", "mean", at_least=0.95),
            Criterion("final error", "final_error_mm", "mm", "mean"),
        ),
        "track": _built_in(
            "track",
            Criterion("RMS error along the normal", "normal_rms_mm", "mm", "rms", at_most=1.0),
            Criterion("RMS error across it", "lateral_rms_mm", "mm", "rms"),
        ),
        "palpate": _built_in(
            "palpate",
            Criterion("success", "success", "", "mean"),
            Criterion("share of the hold time in the band", "in_band_share", "", "min", at_least=0.95),
            Criterion("force over the last hold time", "force_mean_n", "N", "mean"),
        ),
        "scan": _built_in(
            "scan",
            Criterion("RMS of the stand-off", "standoff_rms_mm", "mm", "rms", at_most=0.7),
            Criterion("incidence, mean", "incidence_mean_deg", "deg", "mean"),
            Criterion("incidence, 95th percentile of the worst", "incidence_p95_deg", "deg", at_most=10.0),
            Criterion("share of the scan within 10 deg", "incidence_within_share", "", "mean"),
            Criterion("length of the path", "path_length_mm", "mm", "min", at_least=59.5),
            Criterion("share of the path scanned", "path_progress", "", "min", at_least=1.0),
        ),
        "look": _built_in(
            "look",
            Criterion("offset from the middle, greatest", "centre_share_max", "of the width", at_most=0.05),
            Criterion("the same, mean 95th percentile", "centre_share_p95", "of the width", "mean"),
            Criterion("error of the working distance, greatest", "distance_error_max_mm", "mm", at_most=5.0),
            Criterion("the same, mean 95th percentile", "distance_error_p95_mm", "mm", "mean"),
        ),
    },
)
"""In the order in which the tasks are listed to users."""


def environment_id(task: str, version: int = 0) -> str:
    """Return the id under which Gymnasium knows a task, such as `laploop/Reach-v0`; version 1 is the one for learners."""
    return f"laploop/{re.sub(r'[^0-9A-Za-z]', '', task.title())}-v{version}"


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
    config = task_spec(task).config_class
    if ":" in task:
        # A task that is known by its place alone is found there again, so the place is its kind.
        if get_type_hints(config)["kind"] is not str:
            raise InvalidValueError(
                "task", task, f"a task whose {config.__name__} has a field `kind: str`, or a registered name"
            )
        changes["kind"] = task
    return config(**changes)


def make_environment(task: str, **keywords: Any) -> "TaskEnv[Any]":
    """Make the environment of a task, as `gymnasium.make` does.

    Raises:
        UnknownNameError: If there is no such task.
        InvalidValueError: If its environment does not take a keyword.
    """
    made: TaskEnv[Any] = call_checked("environment", task, task_spec(task).environment_class, **keywords)
    return made


def _resolved(place: Any) -> Any:
    return resolve_name(place) if isinstance(place, str) else place
