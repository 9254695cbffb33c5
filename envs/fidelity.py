"""Fidelity presets: what a task's simulation may cost."""

from dataclasses import replace
from typing import Literal, get_args

from laploop.envs.tasks.task_config import TaskConfig
from laploop.errors import UnknownNameError

FidelityName = Literal["full", "fast"]


def with_fidelity(config: TaskConfig, fidelity: str) -> TaskConfig:
    """Return a task's configuration at a fidelity: full (as it is) or fast (physics steps of 4 ms).

    Raises:
        UnknownNameError: If there is no such fidelity.
    """
    if fidelity not in get_args(FidelityName):
        raise UnknownNameError("fidelity", fidelity, get_args(FidelityName))
    return config if fidelity == "full" else replace(config, loop=replace(config.loop, physics_hz=250.0))
