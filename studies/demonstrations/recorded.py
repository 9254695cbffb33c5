"""Data sets of demonstrations as they are read again, whatever their format."""

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from laploop.errors import DatasetError, InvalidValueError
from laploop.studies.demonstrations.card import Card
from laploop.studies.demonstrations.damage import REMEDY, checked_outcome
from laploop.studies.demonstrations.demonstration import Observations


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedEpisode:
    """What a data set holds of an episode, as the environment told it."""

    observations: Observations
    """(decisions + 1, ...) by key; (decisions, ...) in a format without the last one."""
    actions: NDArray[np.float32]
    """(decisions, components), -1 to 1: what was done."""
    expert_actions: NDArray[np.float32]
    """(decisions, components), -1 to 1: what the expert would have done."""
    rewards: NDArray[np.floating[Any]]
    """Of the format's own precision."""
    terminations: NDArray[np.bool_]
    truncations: NDArray[np.bool_]
    outcome: dict[str, Any]
    """As in `Demonstration`."""


_KINDS = {"actions": "f", "expert_actions": "f", "rewards": "f", "terminations": "b", "truncations": "b"}
"""Of numpy's types, by the name of the array."""


def checked_episode(episode: RecordedEpisode, place: str) -> RecordedEpisode:
    """Return the episode at a place, if its arrays hold numbers, a row a decision, and its outcome is whole.

    Raises:
        DatasetError: If they do not, or it is not.
    """
    for name, kind in _KINDS.items():
        found = getattr(episode, name)
        if found.dtype.kind != kind or len(found) != len(episode.actions):
            allowed = f"{len(episode.actions)} {'numbers' if kind == 'f' else 'truth values'}"
            raise DatasetError(f"{name} of {place} are {len(found)} of {found.dtype}; allowed: {allowed}; {REMEDY}")
    checked_outcome(episode.outcome, place)
    return episode


class RecordedDemonstrations(Protocol):
    """A data set that is open for reading."""

    card: Card
    count: int

    def episode(self, index: int) -> RecordedEpisode:
        """Return an episode, from 0 on.

        Raises:
            DatasetError: If it is damaged.
        """
        ...


def open_demonstrations(path: Path | str) -> RecordedDemonstrations:
    """Open a data set, or the folder that `laploop demonstrate` wrote one to.

    Raises:
        DatasetError: If there is none, or it is damaged, or was made by another version of laploop.
        UnknownNameError: If its task is not known.
        InvalidValueError: If the folder holds data sets of both formats.
    """
    from laploop.studies.demonstrations.lerobot_reader import LeRobotDemonstrations
    from laploop.studies.demonstrations.minari_format import MinariDemonstrations

    given = Path(path)
    with suppress(RuntimeError):  # there is no such user
        given = given.expanduser()
    minari = [found.parent for found in (given / "metadata.json", given / "data" / "metadata.json") if found.is_file()]
    minari += [found.parent for found in sorted(given.glob("minari/laploop/*/data/metadata.json"))]
    lerobot = [folder for folder in (given, given / "lerobot") if (folder / "meta" / "info.json").is_file()]
    found: list[Path] = [*minari, *lerobot]
    if not found:
        raise DatasetError(f"{given} does not hold demonstrations; `laploop demonstrate` writes them")
    if len(found) > 1:
        raise InvalidValueError("data set", str(given), f"one of {', '.join(map(str, found))}")
    return MinariDemonstrations(found[0]) if minari else LeRobotDemonstrations(found[0])


def checked_index(index: int, count: int) -> int:
    """Return the index of an episode; raises an InvalidValueError unless there is such an episode."""
    if not 0 <= index < count:
        raise InvalidValueError("episode", index, f"0 to {count - 1}" if count else "none in an empty data set")
    return index
