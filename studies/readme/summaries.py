"""Reads the committed summaries."""

import json
from pathlib import Path
from typing import Any

from laploop.errors import MissingFileError


def read_summary(path: Path) -> dict[str, Any]:
    """Return a summary.

    Raises:
        MissingFileError: If the file does not exist.
    """
    if not path.is_file():
        raise MissingFileError("summary", path, "run `make results`")
    summary: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return summary
