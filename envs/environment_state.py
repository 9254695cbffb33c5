"""The state of an environment: everything that shapes its future, as one object that pickles.

What changes during an episode is a graph of small objects. It is packed as a whole, by content, so that nothing can be
forgotten; what an environment already has, such as its configuration, estimator, camera and theatre, is packed by name, and
found again under that name in the environment that takes the state over.
"""

import io
import pickle
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from typing import Any

from laploop.configuration import to_plain
from laploop.envs.loop.observed_theatre import SceneState
from laploop.envs.tasks.task_config import TaskConfig
from laploop.errors import InvalidValueError


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class EnvironmentState:
    """What `get_state` of an environment returns and `set_state` takes: opaque, and never changed.

    It pickles and goes to other processes. Another version of laploop refuses it. Like any pickle, one from a stranger runs
    the stranger's code when it is loaded.
    """

    environment: str
    """Class of the environment that it is of."""
    perception: str
    """Its estimator, by name or class."""
    config: TaskConfig
    version: str
    scene: SceneState | None
    """Theatre and camera; None before the first reset."""
    memory: bytes
    """Everything else."""

    def __repr__(self) -> str:
        kib = len(self.memory) / 1024
        return f"<EnvironmentState of {self.environment.rpartition(':')[2]}, {kib:.0f} KiB>"

    def check(self, *, environment: str, perception: str, config: TaskConfig) -> None:
        """Check that the state is one of an environment like this.

        Raises:
            InvalidValueError: If it is not; the message names the first difference.
        """
        for name, mine, own in (
            ("version of laploop", self.version, laploop_version()),
            ("environment", self.environment, environment),
            ("perception", self.perception, perception),
        ):
            if mine != own:
                raise InvalidValueError(f"{name} of the state", mine, f"{own!r}, as here")
        if self.config != config:
            path, mine, own = _first_difference(to_plain(self.config), to_plain(config), "config")
            raise InvalidValueError(f"{path} of the state", mine, f"{own!r}, as in this environment")


@cache
def laploop_version() -> str:
    """Return the version of this package."""
    return version("laploop")


def class_place(kind: type) -> str:
    """Return where a class is: `module:Class`."""
    return f"{kind.__module__}:{kind.__qualname__}"


def packed(graph: Any, parts: Mapping[str, Any]) -> bytes:
    """Return a graph of objects as bytes, the parts in it by their names.

    Raises:
        InvalidValueError: If something in it cannot be pickled.
    """
    names = {id(part): name for name, part in parts.items()}
    buffer = io.BytesIO()
    try:
        _Packer(buffer, names).dump(graph)
    except (pickle.PicklingError, TypeError, AttributeError) as error:
        raise InvalidValueError("state", str(error), "objects that can be pickled") from error
    return buffer.getvalue()


def unpacked(data: bytes, parts: Mapping[str, Any]) -> Any:
    """Return a new graph of what `packed` has made, the parts in it those that are given."""
    return _Unpacker(io.BytesIO(data), parts).load()


class _Packer(pickle.Pickler):
    def __init__(self, buffer: io.BytesIO, names: Mapping[int, str]) -> None:
        super().__init__(buffer, protocol=pickle.HIGHEST_PROTOCOL)
        self._names = names

    def persistent_id(self, obj: Any) -> str | None:
        return self._names.get(id(obj))


class _Unpacker(pickle.Unpickler):
    def __init__(self, buffer: io.BytesIO, parts: Mapping[str, Any]) -> None:
        super().__init__(buffer)
        self._parts = parts

    def persistent_load(self, pid: str) -> Any:
        return self._parts[pid]


def _first_difference(mine: Any, own: Any, path: str) -> tuple[str, Any, Any]:
    """Return the path of the first leaf in which two plain trees differ, and both values; of the trees where none does."""
    if isinstance(mine, Mapping) and isinstance(own, Mapping) and mine.keys() == own.keys():
        for key in mine:
            if mine[key] != own[key]:
                return _first_difference(mine[key], own[key], f"{path}.{key}")
    return path, mine, own
