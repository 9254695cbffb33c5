"""The folder that a command writes: every artefact whole or not at all, the summary last."""

import dataclasses
import json
import math
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from platform import python_version
from typing import Any, Self

import numpy as np

from laploop.errors import LaploopError, OutputError

SUMMARY = "summary.json"

_VERSIONED = ("laploop", "mujoco", "warp-lang", "torch", "pin", "pin-pink", "numpy", "gymnasium", "rerun-sdk")


class OutputFolder:
    """An output folder, checked for writing before any work is done.

    An artefact is written under a hidden name and renamed when it is complete. A summary that an earlier run left is removed
    as soon as the first artefact of this run is in place: a folder with a summary always holds what the summary tells. If the
    block of this context manager raises, artefacts that were complete stay; a folder made in vain is removed.
    """

    def __init__(self, path: Path | str, command: str) -> None:
        """Make the folder where it does not exist, and try to write in it.

        Args:
            path: The folder.
            command: Name of the command, for the summary.

        Raises:
            OutputError: If the folder cannot be made or written.
        """
        self.path = Path(path).expanduser()
        self.command = command
        self._begin = time.perf_counter()
        self._made: list[Path] = []
        self._artefacts: list[str] = []
        try:
            missing = [folder for folder in (self.path, *self.path.parents) if not folder.exists()]
            for folder in reversed(missing):
                folder.mkdir(exist_ok=True)
                self._made.append(folder)
            probe = self.path / ".laploop-probe"
            try:
                probe.write_bytes(b"x")
            finally:
                probe.unlink(missing_ok=True)
        except OSError as error:
            self._remove_made()
            raise _output_error(self.path, error) from error

    def __enter__(self) -> Self:
        """Return the folder."""
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Remove the folder if it was made for this run, the run failed, and nothing was saved."""
        if kind is not None:
            self._remove_made()

    @contextmanager
    def artefact(self, name: str) -> Iterator[Path]:
        """Give a hidden path to write to; it becomes `name` when the block ends, and is removed when the block raises.

        Raises:
            OutputError: If the system refuses to write, because the disk is full for example.
        """
        final = self.path / name
        partial = final.with_name(f".{final.name}.partial")
        try:
            final.parent.mkdir(parents=True, exist_ok=True)
            yield partial
            if name != SUMMARY:
                self.forget_summary()
            partial.replace(final)
            self._artefacts.append(name)
        except OSError as error:
            if isinstance(error, LaploopError) or error.filename not in {None, str(partial)}:
                raise
            raise _output_error(final, error) from error
        finally:
            partial.unlink(missing_ok=True)

    def forget_summary(self) -> None:
        """Remove the summary of an earlier run; for commands whose artefacts are not written through `artefact`."""
        (self.path / SUMMARY).unlink(missing_ok=True)

    def write_text(self, name: str, text: str) -> None:
        """Write a text artefact."""
        with self.artefact(name) as path:
            path.write_text(text, encoding="utf-8")

    def write_summary(self, results: Mapping[str, Any], *, config: Any, seed: int | None) -> dict[str, Any]:
        """Write `summary.json`, the last artefact of a command.

        Args:
            results: What the command adds.
            config: The resolved configuration, a dataclass or a mapping.
            seed: The seed, None for a command without randomness.

        Returns:
            What was written.
        """
        summary = {
            "command": self.command,
            "config": plain(config),
            "seed": seed,
            "versions": versions(),
            "wall_s": round(time.perf_counter() - self._begin, 3),
            "artefacts": list(self._artefacts),
            **plain(results),
        }
        self.write_text(SUMMARY, json.dumps(summary, indent=2, allow_nan=False) + "\n")
        return summary

    def _remove_made(self) -> None:
        for folder in reversed(self._made):
            try:
                folder.rmdir()
            except OSError:
                return


def _output_error(path: Path, error: OSError) -> OutputError:
    reason = error.strerror or str(error)
    return OutputError(f"cannot write {path}: {reason}; choose another --out or make it writable")


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that decide results."""
    found = {"python": python_version()}
    for package in _VERSIONED:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def plain(value: Any) -> Any:
    """Turn dataclasses, arrays, paths and the like into what JSON knows; numbers that are not finite become null."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    elif isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, str | int | float | bool) else str(value)
