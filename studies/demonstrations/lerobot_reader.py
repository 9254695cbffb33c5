"""Reads demonstrations in the layout of LeRobot's data sets."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import parquet

from laploop.errors import DatasetError
from laploop.studies.demonstrations.card import Card
from laploop.studies.demonstrations.lerobot_layout import (
    ACTION,
    CARD,
    DATA,
    EPISODES,
    IMAGE,
    INFO,
    VERSION,
    decoded_image,
    observations_of,
)
from laploop.studies.demonstrations.recorded import RecordedEpisode, checked_index


class LeRobotDemonstrations:
    """A data set that `write_lerobot` wrote."""

    def __init__(self, folder: Path) -> None:
        """Open it.

        Raises:
            DatasetError: If it is damaged, of another kind, or made by another version of laploop.
        """
        self._folder = folder
        if (version := self._json(INFO).get("codebase_version")) != VERSION:
            raise DatasetError(f"{folder} has LeRobot's layout {version}; this reads {VERSION}")
        if not (folder / CARD).is_file():
            raise DatasetError(f"{folder} does not hold demonstrations; `laploop demonstrate` writes them")
        described = self._json(CARD)
        self._outcomes: list[dict[str, Any]] = described.pop("episodes", [])
        self.card = Card.read(described, folder)
        self._episodes = self._table(folder / EPISODES.format(chunk_index=0, file_index=0)).to_pylist()
        self.count = len(self._episodes)

    def episode(self, index: int) -> RecordedEpisode:
        """Return an episode; raises as `RecordedDemonstrations.episode`."""
        columns = self.columns(checked_index(index, self.count))
        truncations = columns["next.truncated"]
        return RecordedEpisode(
            observations=observations_of(columns, self.card),
            actions=columns[ACTION],
            rewards=columns["next.reward"],
            terminations=columns["next.done"] & ~truncations,
            truncations=truncations,
            outcome=self._outcomes[index],
        )

    def columns(self, index: int) -> dict[str, NDArray[Any]]:
        """Return an episode's features, (decisions, ...) each, images decoded."""
        row = self._episodes[index]
        place = {"chunk_index": row["data/chunk_index"], "file_index": row["data/file_index"]}
        table = self._table(self._folder / DATA.format(**place), filters=[("episode_index", "=", index)])
        if table.num_rows != row["length"]:
            raise DatasetError(f"episode {index} of {self._folder} has {table.num_rows} of {row['length']} rows")
        return {name: _numbers(name, table[name].combine_chunks()) for name in table.column_names}

    def _table(self, path: Path, **options: Any) -> pa.Table:
        try:
            return parquet.read_table(path, partitioning=None, **options)
        except (OSError, pa.ArrowInvalid) as error:
            raise DatasetError(f"{path} cannot be read: {error}") from error

    def _json(self, name: str) -> dict[str, Any]:
        path = self._folder / name
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise DatasetError(f"{path} cannot be read: {error}") from error
        if not isinstance(found, dict):
            raise DatasetError(f"{path} holds no table")
        return found


def _numbers(name: str, column: pa.Array) -> NDArray[Any]:
    if name.startswith(IMAGE):
        return np.stack([decoded_image(data) for data in column.field("bytes").to_pylist()])
    if pa.types.is_fixed_size_list(column.type):
        return np.asarray(column.flatten().to_numpy(zero_copy_only=False).reshape(len(column), -1))
    return np.asarray(column.to_numpy(zero_copy_only=False))
