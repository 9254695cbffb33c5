"""Reads demonstrations in the layout of LeRobot's data sets."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import parquet

from laploop.errors import DatasetError
from laploop.perception.data.integrity import refusing_damage
from laploop.studies.demonstrations.card import Card
from laploop.studies.demonstrations.damage import REMEDY, read_table, require
from laploop.studies.demonstrations.lerobot_layout import (
    ACTION,
    CARD,
    DATA,
    EPISODES,
    IMAGE,
    INFO,
    STATE,
    VERSION,
    decoded_image,
    observations_of,
)
from laploop.studies.demonstrations.recorded import RecordedEpisode, checked_episode, checked_index

_PLACE = ("length", "data/chunk_index", "data/file_index")
"""Columns of the table of episodes that are read."""
_NEEDED = ("episode_index", STATE, ACTION, "expert_action", "next.reward", "next.done", "next.truncated")
"""Columns of the data that are read, beside images."""


class LeRobotDemonstrations:
    """A data set that `write_lerobot` wrote."""

    def __init__(self, folder: Path) -> None:
        """Open it.

        Raises:
            DatasetError: If it is damaged, of another kind, or made by another version of laploop.
        """
        self._folder = folder
        if (version := read_table(folder / INFO).get("codebase_version")) != VERSION:
            raise DatasetError(f"{folder / INFO} has the codebase_version {version!r}; allowed: {VERSION!r}; {REMEDY}")
        if not (folder / CARD).is_file():
            raise DatasetError(f"{folder} does not hold demonstrations; `laploop demonstrate` writes them")
        described = read_table(folder / CARD)
        outcomes = described.pop("episodes", None)
        self.card = Card.read(described, folder)
        path = folder / EPISODES.format(chunk_index=0, file_index=0)
        self._episodes = self._table(path, _PLACE).to_pylist()
        self.count = len(self._episodes)
        if not isinstance(outcomes, list) or len(outcomes) != self.count:
            told = len(outcomes) if isinstance(outcomes, list) else "none"
            raise DatasetError(f"{folder / CARD} tells of {told} of the {self.count} episodes; {REMEDY}")
        self._outcomes = outcomes

    def episode(self, index: int) -> RecordedEpisode:
        """Return an episode; raises as `RecordedDemonstrations.episode`."""
        checked_index(index, self.count)
        place = f"episode {index} of {self._folder}"
        with refusing_damage(place, REMEDY):
            columns = self.columns(index)
            truncations = columns["next.truncated"]
            found = RecordedEpisode(
                observations=observations_of(columns, self.card),
                actions=columns[ACTION],
                expert_actions=columns["expert_action"],
                rewards=columns["next.reward"],
                terminations=columns["next.done"] & ~truncations,
                truncations=truncations,
                outcome=self._outcomes[index],
            )
        return checked_episode(found, place)

    def columns(self, index: int) -> dict[str, NDArray[Any]]:
        """Return an episode's features, (decisions, ...) each, images decoded."""
        row = self._episodes[index]
        place = {"chunk_index": row["data/chunk_index"], "file_index": row["data/file_index"]}
        table = self._table(self._folder / DATA.format(**place), _NEEDED, filters=[("episode_index", "=", index)])
        if table.num_rows != row["length"]:
            raise DatasetError(f"episode {index} of {self._folder} has {table.num_rows} of {row['length']} rows; {REMEDY}")
        return {name: _numbers(name, table[name].combine_chunks()) for name in table.column_names}

    def _table(self, path: Path, needed: Sequence[str], **options: Any) -> pa.Table:
        with refusing_damage(str(path), REMEDY):
            require(path, "column", needed, parquet.read_schema(path).names)
            return parquet.read_table(path, partitioning=None, **options)


def _numbers(name: str, column: pa.Array) -> NDArray[Any]:
    if name.startswith(IMAGE):
        return np.stack([decoded_image(data) for data in column.field("bytes").to_pylist()])
    if pa.types.is_fixed_size_list(column.type):
        return np.asarray(column.flatten().to_numpy(zero_copy_only=False).reshape(len(column), -1))
    return np.asarray(column.to_numpy(zero_copy_only=False))
