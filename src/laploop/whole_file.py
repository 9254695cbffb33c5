"""Files that appear whole or not at all."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from laploop.errors import LaploopError, OutputError


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a hidden path to write to; it becomes `path` when the block ends, and is removed when the block raises.

    Raises:
        OutputError: If the system refuses to write, because the disk is full for example.
    """
    partial = path.with_name(f".{path.name}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield partial
        partial.replace(path)
    except OSError as error:
        if isinstance(error, LaploopError) or error.filename not in {None, str(partial), str(path.parent)}:
            raise
        raise OutputError(f"cannot write {path}: {error.strerror or error}; choose another folder") from error
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
