"""The tasks by name: their environments, and the scripted controllers that solve them.

Nothing heavy is loaded before a task is asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from laploop.errors import UnknownNameError

if TYPE_CHECKING:
    from laploop.envs.tasks.task_env import TaskEnv

TASKS = {
    "reach": "laploop.envs.tasks.reach:ReachEnv",
    "track": "laploop.envs.tasks.track:TrackEnv",
    "palpate": "laploop.envs.tasks.palpate:PalpateEnv",
    "scan": "laploop.envs.tasks.scan:ScanEnv",
    "look": "laploop.envs.tasks.look:LookEnv",
}
"""Entry points of the environments, in the order in which the tasks are listed to users."""


def environment_id(task: str) -> str:
    """Return the id under which Gymnasium knows a task, such as `laploop/Reach-v0`."""
    return f"laploop/{task.capitalize()}-v0"


def task_environment(task: str) -> "type[TaskEnv[Any]]":
    """Return the environment class of a task.

    Raises:
        UnknownNameError: If there is no such task.
    """
    if task not in TASKS:
        raise UnknownNameError("task", task, TASKS)
    module, _, name = TASKS[task].partition(":")
    found: type[TaskEnv[Any]] = getattr(import_module(module), name)
    return found
