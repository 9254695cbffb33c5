"""Writes demonstrations in the layout of LeRobot's data sets."""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import parquet

from laploop.errors import DatasetError, InvalidValueError
from laploop.studies.demonstrations.card import Card
from laploop.studies.demonstrations.demonstration import Demonstration
from laploop.studies.demonstrations.feature_stats import Stats, feature_stats, joined_stats
from laploop.studies.demonstrations.lerobot_layout import (
    CARD,
    CHUNK_FILES,
    DATA,
    EPISODES,
    FILE_MB,
    IMAGE,
    INFO,
    STATS,
    TASKS,
    VERSION,
    columns_of,
    encoded_image,
    features_of,
)

_IMAGE_TYPE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])


def frames_per_second(card: Card) -> int:
    """Return the rate of the rows, which LeRobot wants to be a whole number.

    Raises:
        InvalidValueError: If it is none.
    """
    rate = 1e3 / card.decision_period_ms
    if rate != round(rate):
        raise InvalidValueError(
            "decision_period_ms", card.decision_period_ms, "a whole number a second for LeRobot, as 40 or 8"
        )
    return round(rate)


def write_lerobot(folder: Path, card: Card, demonstrations: Iterable[Demonstration]) -> None:
    """Write a data set to an existing, empty folder, to be read by `LeRobotDataset(repo_id, root=folder)`.

    Raises:
        InvalidValueError: If the rate of decisions is no whole number.
        DatasetError: If there is no episode.
    """
    writer = _Writer(folder, card)
    try:
        for one in demonstrations:
            writer.add(one)
    finally:
        writer.close_file()
    writer.finish()


class _Writer:
    """Files of up to `FILE_MB`, and what is known of the episodes so far."""

    def __init__(self, folder: Path, card: Card) -> None:
        self._folder, self._card, self._fps = folder, card, frames_per_second(card)
        self._file: parquet.ParquetWriter | None = None
        self._files, self._bytes, self._rows = 0, 0, 0
        self._features: dict[str, dict[str, Any]] = {}
        self._episodes: list[dict[str, Any]] = []
        self._stats: list[dict[str, Stats]] = []
        self._outcomes: list[dict[str, Any]] = []

    def add(self, one: Demonstration) -> None:
        """Write the rows of an episode."""
        columns = columns_of(one)
        self._features = self._features or features_of(self._card, columns)
        count, index = len(one.actions), len(self._episodes)
        frames = np.arange(count)
        columns |= {
            "timestamp": (frames / self._fps).astype(np.float32),
            "frame_index": frames,
            "episode_index": np.full(count, index),
            "index": self._rows + frames,
            "task_index": np.zeros(count, np.int64),
        }
        table = pa.table({name: _array(name, column) for name, column in columns.items()})
        self._opened(table).write_table(table, row_group_size=count)
        self._bytes += table.nbytes
        place = self._place(self._files - 1)
        stats = {name: feature_stats(column, image=name.startswith(IMAGE)) for name, column in columns.items()}
        self._episodes.append(
            {
                "episode_index": index,
                "tasks": [self._card.instruction],
                "length": count,
                "data/chunk_index": place["chunk_index"],
                "data/file_index": place["file_index"],
                "dataset_from_index": self._rows,
                "dataset_to_index": self._rows + count,
                "meta/episodes/chunk_index": 0,
                "meta/episodes/file_index": 0,
            }
        )
        self._stats.append(stats)
        self._outcomes.append(one.outcome)
        self._rows += count

    def close_file(self) -> None:
        """End the file that is being written."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def finish(self) -> None:
        """Write what is known of all episodes."""
        if not self._episodes:
            raise DatasetError("a data set needs at least one episode")
        rows = [
            {**row, **{f"stats/{name}/{kind}": value for name, one in stats.items() for kind, value in one.items()}}
            for row, stats in zip(self._episodes, self._stats, strict=True)
        ]
        path = self._folder / EPISODES.format(chunk_index=0, file_index=0)
        path.parent.mkdir(parents=True)
        parquet.write_table(pa.Table.from_pylist(rows), path)
        parquet.write_table(_tasks_table(self._card.instruction), self._folder / TASKS)
        self._write(STATS, joined_stats(list(self._stats)))
        self._write(INFO, self._info())
        self._write(CARD, {**self._card.plain, "episodes": self._outcomes})

    def _opened(self, table: pa.Table) -> parquet.ParquetWriter:
        """Return the file for an episode, a new one where the last is full."""
        if self._file is not None and self._bytes + table.nbytes > FILE_MB * 2**20:
            self.close_file()
        if self._file is None:
            path = self._folder / DATA.format(**self._place(self._files))
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = parquet.ParquetWriter(path, table.schema)
            self._files, self._bytes = self._files + 1, 0
        return self._file

    def _place(self, number: int) -> dict[str, int]:
        return {"chunk_index": number // CHUNK_FILES, "file_index": number % CHUNK_FILES}

    def _info(self) -> dict[str, Any]:
        return {
            "codebase_version": VERSION,
            "robot_type": "ur5_laparoscopy",
            "total_episodes": len(self._episodes),
            "total_frames": self._rows,
            "total_tasks": 1,
            "chunks_size": CHUNK_FILES,
            "data_files_size_in_mb": FILE_MB,
            "video_files_size_in_mb": 2 * FILE_MB,
            "fps": self._fps,
            "splits": {"train": f"0:{len(self._episodes)}"},
            "data_path": DATA,
            "video_path": None,
            "features": self._features,
        }

    def _write(self, name: str, content: Mapping[str, Any]) -> None:
        (self._folder / name).write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def _array(name: str, column: NDArray[Any]) -> pa.Array:
    """Return a column as Arrow has it: images encoded, vectors as lists of fixed length, numbers alone."""
    if name.startswith(IMAGE):
        return pa.array([{"bytes": encoded_image(image), "path": None} for image in column], type=_IMAGE_TYPE)
    if column.ndim == 1:
        return pa.array(column)
    return pa.FixedSizeListArray.from_arrays(pa.array(column.reshape(-1)), column.shape[1])


def _tasks_table(instruction: str) -> pa.Table:
    """Return the table of tasks, whose index pandas takes from the schema's metadata."""
    table = pa.table({"task_index": pa.array([0], pa.int64()), "task": pa.array([instruction])})
    label = {
        "field_name": None,
        "name": None,
        "pandas_type": "unicode",
        "numpy_type": "object",
        "metadata": {"encoding": "UTF-8"},
    }
    columns = [
        {"field_name": name, "name": name, "pandas_type": kind, "numpy_type": numpy_kind, "metadata": None}
        for name, kind, numpy_kind in (("task_index", "int64", "int64"), ("task", "unicode", "object"))
    ]
    described = {
        "index_columns": ["task"],
        "column_indexes": [label],
        "columns": columns,
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "2.2.0",
    }
    return table.replace_schema_metadata({"pandas": json.dumps(described)})
