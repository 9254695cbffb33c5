"""What differs from episode to episode: distributions over paths of a task's configuration."""

import zlib
from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from typing import Any, TypeVar

import numpy as np
from pydantic import JsonValue

from laploop.configuration import at_path, from_plain, merged, to_plain
from laploop.envs.randomisation.distributions import Distribution
from laploop.envs.tasks.task_config import TaskConfig
from laploop.errors import InvalidValueError, UnknownNameError

ConfigT = TypeVar("ConfigT", bound=TaskConfig)

Values = dict[str, JsonValue]
"""What was drawn, by path."""

_STREAM = 83
"""Keeps the random numbers apart from those of theatres, whose seeds are the same integers."""

_INTERFACE = (
    "kind",
    "action_mode",
    "observation_mode",
    "max_seconds",
    "max_tip_speed_mps",
    "max_joint_speed_radps",
    "loop.control_hz",
    "loop.device",
    "loop.theatre.scope.width",
    "loop.theatre.scope.height",
)
"""Fields that spaces, scales and lengths of steps depend on, which all episodes of an environment share."""

_SCOPE = "loop.theatre.scope"
_SUGGESTIONS = 5


class Randomisation:
    """A distribution for each of some paths of a task's configuration, as `loop.theatre.tissue.material.young_pa`.

    Each path has random numbers of its own, from the episode's seed: what one draws depends neither on the others nor on the
    width.
    """

    def __init__(self, distributions: Mapping[str, Distribution]) -> None:
        """Take distributions by path.

        Raises:
            InvalidValueError: If a path lies within another, or is of a field that all episodes of an environment share.
        """
        self.distributions = dict(distributions)
        for path in self.distributions:
            if (fixed := next((one for one in _INTERFACE if _overlap(path, one)), None)) is not None:
                raise InvalidValueError("path", path, f"none that holds {fixed}, which all episodes of an environment share")
            if (other := next((one for one in self.distributions if one != path and _overlap(path, one)), None)) is not None:
                raise InvalidValueError("path", path, f"none within another, or around it, such as {other}")

    @property
    def changes_scope(self) -> bool:
        """Whether episodes differ in the scope's geometry, which estimators are made for."""
        return self.drawn_at(_SCOPE) is not None

    def drawn_at(self, path: str) -> str | None:
        """Return the first path with a distribution that is the same as a path, within it or around it."""
        return next((one for one in self.distributions if _overlap(one, path)), None)

    @property
    def plain(self) -> dict[str, dict[str, JsonValue]]:
        """As a file has it."""
        return {path: one.plain for path, one in self.distributions.items()}

    def check(self, config: TaskConfig) -> None:
        """Check that a task has these paths, and allows for all lower ends at once, all upper ends, and every choice.

        Raises:
            UnknownNameError: If there is no such path; the message names the nearest.
            LaploopError: If a value is not allowed.
        """
        plain = to_plain(config)
        for path in self.distributions:
            _nominal(plain, path)
        samples = {path: one.samples for path, one in self.distributions.items()}
        for number in range(max(map(len, samples.values()), default=0)):
            with_values(config, {path: values[min(number, len(values) - 1)] for path, values in samples.items()})

    def draw(self, config: TaskConfig, seed: int, width: float = 1.0) -> Values:
        """Draw the values of an episode.

        Args:
            config: The nominal task.
            seed: The episode's.
            width: 0 to 1: how far from the nominal values; at 0 nothing is drawn.
        """
        if width == 0.0:
            return {}
        plain = to_plain(config)
        return {
            path: distribution.draw(_stream(seed, path), _nominal(plain, path), width)
            for path, distribution in self.distributions.items()
        }


def with_values(config: ConfigT, values: Mapping[str, Any]) -> ConfigT:
    """Return a task's configuration with values, plain as a file has them, at their paths.

    Raises:
        LaploopError: If there is no such path, or a value is not allowed.
    """
    if not values:
        return config
    plain = to_plain(config)
    for path, value in values.items():
        plain = merged(plain, at_path(path, value))
    return from_plain(type(config), plain)


def checked_width(width: object) -> float:
    """Return a width of 0 to 1; raises an InvalidValueError for anything else."""
    if isinstance(width, bool) or not isinstance(width, int | float) or not 0.0 <= width <= 1.0:
        raise InvalidValueError("width", width, "0 (nominal) to 1 (as given)")
    return float(width)


def _stream(seed: int, path: str) -> np.random.RandomState:
    """Return a path's random numbers; of the kind that dm_control's variations take."""
    sequence = np.random.SeedSequence((seed, _STREAM, zlib.crc32(path.encode())))
    return np.random.RandomState(np.random.MT19937(sequence))


def _nominal(plain: Mapping[str, Any], path: str) -> JsonValue:
    value: Any = plain
    for part in path.split("."):
        if not isinstance(value, Mapping) or part not in value:
            raise UnknownNameError("path", path, _suggestions(plain, path))
        value = value[part]
    found: JsonValue = value
    return found


def _suggestions(plain: Mapping[str, Any], path: str) -> list[str]:
    """Return the paths that are most like one; those that end alike come first."""
    known = list(_paths(plain))
    last = path.rpartition(".")[2]
    alike = [one for one in known if one.rpartition(".")[2] == last]
    return (alike or get_close_matches(path, known, n=_SUGGESTIONS) or sorted(plain))[:_SUGGESTIONS]


def _paths(plain: Mapping[str, Any], before: str = "") -> Iterator[str]:
    for name, value in plain.items():
        path = f"{before}{name}"
        yield path
        if isinstance(value, Mapping):
            yield from _paths(value, f"{path}.")


def _overlap(one: str, other: str) -> bool:
    """Return whether two paths are the same, or one lies within the other."""
    return f"{one}.".startswith(f"{other}.") or f"{other}.".startswith(f"{one}.")
