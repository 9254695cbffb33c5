"""Finished episodes on disk, so that a collection that was stopped goes on where it was."""

import json
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from laploop.errors import InvalidValueError
from laploop.studies.demonstrations.demonstration import Demonstration
from laploop.whole_file import whole_file

_OBSERVED = "observations."
_ARRAYS = tuple(field.name for field in fields(Demonstration) if field.name not in {"observations", "outcome"})


class EpisodeFolder:
    """A folder with a compressed file for each seed; those of another configuration or other code do not count."""

    def __init__(self, path: Path, key: str) -> None:
        """Take the folder and the key of the configuration."""
        self.path = path
        self._key = key

    def outcome(self, seed: int) -> dict[str, Any] | None:
        """Return the outcome of a seed's episode, None if there is none.

        Raises:
            InvalidValueError: If the file is damaged.
        """
        if not self._file(seed).exists():
            return None
        with self._opened(seed) as found:
            header = json.loads(str(found["header"]))
            outcome: dict[str, Any] | None = header["outcome"] if header["key"] == self._key else None
        return outcome

    def save(self, demonstration: Demonstration) -> None:
        """Write an episode, whole or not at all."""
        header = {"key": self._key, "outcome": demonstration.outcome}
        content: dict[str, Any] = {name: getattr(demonstration, name) for name in _ARRAYS}
        content |= {f"{_OBSERVED}{name}": array for name, array in demonstration.observations.items()}
        with whole_file(self._file(demonstration.outcome["seed"])) as path, path.open("wb") as stream:
            np.savez_compressed(stream, header=json.dumps(header), **content)

    def load(self, seed: int) -> Demonstration:
        """Return the episode of a seed that has an outcome.

        Raises:
            InvalidValueError: If the file is damaged.
        """
        with self._opened(seed) as found:
            observed = {name.removeprefix(_OBSERVED): found[name] for name in found.files if name.startswith(_OBSERVED)}
            arrays = {name: found[name] for name in _ARRAYS}
            return Demonstration(observations=observed, outcome=json.loads(str(found["header"]))["outcome"], **arrays)

    def _file(self, seed: int) -> Path:
        return self.path / f"seed_{seed:06d}.npz"

    @contextmanager
    def _opened(self, seed: int) -> Iterator[Any]:
        path = self._file(seed)
        try:
            with path.open("rb") as stream, np.load(stream, allow_pickle=False) as found:
                yield found
        except (ValueError, KeyError, OSError, EOFError, zipfile.BadZipFile, zlib.error) as error:
            raise InvalidValueError("kept episode", str(path), "as this command wrote it; remove the file") from error
