"""The folder that a command writes to: every artefact whole or not at all, the summary last."""

import dataclasses
import json
import math
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from platform import python_version
from typing import Any, Self

import numpy as np
from filelock import FileLock, Timeout

from laploop.errors import OutputError
from laploop.whole_file import whole_file

SUMMARY = "summary.json"

_VERSIONED = ("laploop", "mujoco", "warp-lang", "torch", "pin", "pin-pink", "numpy", "gymnasium", "rerun-sdk")


class OutputFolder:
    """An output folder, checked for writing and locked against other commands before any work is done.

    A summary that an earlier run left is removed as soon as the first artefact of this run is in place: a folder with a summary
    always holds what the summary describes. If the block of this context manager raises, artefacts that were complete stay; a
    folder made in vain is removed.
    """

    def __init__(self, path: Path | str, command: str) -> None:
        """Make the folder where it does not exist, lock it, and remove what a killed command left half-written.

        Raises:
            OutputError: If the folder cannot be made or written, or another command is writing to it.
        """
        self.command = command
        self._begin = time.perf_counter()
        self._made: list[Path] = []
        self._artefacts: list[str] = []
        try:
            self.path = Path(path).expanduser()
        except RuntimeError as error:
            raise OutputError(f"cannot write {path}: {error}") from error
        self._lock_path = self.path / ".laploop.lock"
        self._lock = FileLock(self._lock_path)
        try:
            missing = [folder for folder in (self.path, *self.path.parents) if not folder.exists()]
            for folder in reversed(missing):
                folder.mkdir(exist_ok=True)
                self._made.append(folder)
            if not _joins_another_process(command):
                self._lock.acquire(blocking=False)
                for partial in self.path.glob(".*.partial"):
                    if partial.is_file():
                        partial.unlink()
        except Timeout as error:
            raise OutputError(f"{self.path} is in use by another laploop command; choose another --out or wait") from error
        except OSError as error:
            self._release()
            raise OutputError(
                f"cannot write {self.path}: {error.strerror or error}; choose another --out or make it writable"
            ) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Unlock the folder; remove it if it was made for this run, the run failed, and nothing was saved."""
        self._release()

    @contextmanager
    def artefact(self, name: str) -> Iterator[Path]:
        """Give a hidden path to write to; it becomes `name` when the block ends, and is removed when the block raises.

        Raises:
            OutputError: If the system refuses to write, because the disk is full for example.
        """
        with whole_file(self.path / name) as path:
            yield path
            if name != SUMMARY:
                self.forget_summary()
        self._artefacts.append(name)

    @contextmanager
    def own_artefact(self, name: str) -> Iterator[Path]:
        """Give the path of an artefact whose writer hides it until it is whole, and may keep it when the block raises."""
        path = self.path / name
        before = path.stat().st_ino if path.exists() else None
        try:
            yield path
        finally:
            if path.exists() and path.stat().st_ino != before:
                self.forget_summary()
                self._artefacts.append(name)

    def forget_summary(self) -> None:
        """Remove the summary of an earlier run; for commands whose artefacts are not written through `artefact`."""
        (self.path / SUMMARY).unlink(missing_ok=True)

    def write_text(self, name: str, text: str) -> None:
        """Write a text artefact."""
        with self.artefact(name) as path:
            path.write_text(text, encoding="utf-8")

    def write_bytes(self, name: str, content: bytes) -> None:
        """Write a binary artefact."""
        with self.artefact(name) as path:
            path.write_bytes(content)

    def write_json(self, name: str, values: Any) -> None:
        """Write an artefact as JSON; numbers that are not finite become null."""
        self.write_text(name, json.dumps(plain(values), indent=2, allow_nan=False) + "\n")

    def write_summary(self, results: Mapping[str, Any], *, config: Any, seed: int | None) -> dict[str, Any]:
        """Write `summary.json`, the last artefact of a command, and return it; `seed` is None for one without randomness."""
        summary = {
            "command": self.command,
            "config": plain(config),
            "seed": seed,
            "versions": versions(),
            "wall_s": round(time.perf_counter() - self._begin, 3),
            "artefacts": list(self._artefacts),
            **plain(results),
        }
        self.write_json(SUMMARY, summary)
        return summary

    def _release(self) -> None:
        """Give the lock back with its file, and remove the folders made for it that hold nothing."""
        if self._lock.is_locked:
            with suppress(OSError):
                self._lock_path.unlink(missing_ok=True)
            self._lock.release()
        for folder in reversed(self._made):
            try:
                folder.rmdir()
            except OSError:
                return


def _joins_another_process(command: str) -> bool:
    """Return whether this is a further process of a distributed training, which writes where the first one does."""
    ranks = ("RANK", "LOCAL_RANK", "NODE_RANK", "SLURM_PROCID")
    return command == "train" and any(os.environ.get(rank, "0") != "0" for rank in ranks)


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
    """Turn dataclasses, arrays, paths and the like into plain JSON values; numbers that are not finite become null."""
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
