"""Integrity of stored data: checksums, and one kind of error for every kind of damage."""

import hashlib
import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from laploop.errors import DatasetError, LaploopError, MissingFileError, OutputError

CHECKSUM_BYTES = hashlib.sha256().digest_size


def open_group(path: Path, command: str, *, writable: bool = False) -> Any:
    """Open the Zarr group of a data set, which some command makes; its contents are not checked.

    Raises:
        MissingFileError: If there is none.
        DatasetError: If the path is a file.
    """
    import zarr

    if path.is_file():
        raise DatasetError(f"data set {path} is a file; allowed: a folder that {command} wrote")
    if not (path / "zarr.json").is_file():
        raise MissingFileError("data set", path, f"make one with {command}")
    return zarr.open_group(store=path, mode="r+" if writable else "r")


@contextmanager
def refusing_damage(what: str, remedy: str = "") -> Iterator[None]:
    """Turn every error that damaged files cause in Zarr, Parquet, JSON or the system into one of ours.

    Args:
        what: The file or data set.
        remedy: What the user can do about it.

    Raises:
        DatasetError: If the block raises any other error.
    """
    try:
        yield
    except LaploopError:
        raise
    except Exception as error:
        reason = str(error).partition("\n")[0][:200] or type(error).__name__
        raise DatasetError(f"{what} cannot be used: {reason}{remedy and f'; {remedy}'}") from error


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Give a hidden folder to fill; it becomes `path` when the block ends, and is removed when the block raises.

    Raises:
        OutputError: If the path exists or cannot be written.
    """
    partial = path.with_name(f".{path.name}.partial")
    try:
        _refuse_existing(path)
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        yield partial
        partial.rename(path)
    except OSError as error:
        raise OutputError(f"cannot write a data set to {path}: {error}") from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def compare(what: str, content: bytes, checksum: str) -> None:
    """Raise a ValueError unless some content has the checksum that was stored for it."""
    if sha256(content) != checksum:
        raise ValueError(f"{what} differs from what was written (checksum)")


def sha256(content: bytes) -> str:
    """Return the checksum of some content."""
    return hashlib.sha256(content).hexdigest()


def sha256_of_json(attributes: Mapping[str, Any]) -> str:
    """Return the checksum of plain data."""
    return sha256(json.dumps(attributes, sort_keys=True, allow_nan=False).encode())


def _refuse_existing(path: Path) -> None:
    if path.exists():
        raise FileExistsError("it exists already; give a new folder")
