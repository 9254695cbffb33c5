"""Fidelity presets: how much a second of a task's simulation may cost."""

from dataclasses import replace
from typing import Literal, TypeVar, get_args

from laploop.envs.tasks.task_config import TaskConfig
from laploop.errors import UnknownNameError

FidelityName = Literal["full", "fast"]
"""The fidelities, in the order in which they are listed to users."""

ConfigT = TypeVar("ConfigT", bound=TaskConfig)

_PHYSICS_HZ = {"full": 500.0, "fast": 250.0}
_CONTACT_EVERY = {"full": 1, "fast": 2}


def with_fidelity(config: ConfigT, fidelity: str) -> ConfigT:
    """Return a task's configuration at a fidelity.

    `full`, the default of all tasks, has physics steps of 2 ms: for studies. `fast` has steps of 4 ms, and contacts feel every
    other sample of the tissue's top: for learning. What that changes in displacement, force, depth and success is measured by
    `laploop fidelity`.

    Raises:
        UnknownNameError: If there is no such fidelity.
        InvalidValueError: If the rest of the configuration does not allow for it, as a robot cycle of 2 ms.
    """
    if fidelity not in get_args(FidelityName):
        raise UnknownNameError("fidelity", fidelity, get_args(FidelityName))
    theatre = config.loop.theatre
    theatre = replace(theatre, tissue=replace(theatre.tissue, contact_every=_CONTACT_EVERY[fidelity]))
    return replace(config, loop=replace(config.loop, physics_hz=_PHYSICS_HZ[fidelity], theatre=theatre))
