"""Refuses what is damaged in a data set of demonstrations, whatever its format: says where, what is missing, what to do."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from laploop.errors import DatasetError

REMEDY = "make the data set again with `laploop demonstrate`"

_COUNTS, _DRAWN = ("seed", "decisions"), "randomisation"
"""What a replay needs of an episode's outcome: numbers from 0 on, and a table."""


def read_table(path: Path) -> dict[str, Any]:
    """Return a table that a JSON file holds.

    Raises:
        DatasetError: If the file holds none, or cannot be read.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    # Deep nesting ends in a RecursionError.
    except (OSError, ValueError, RecursionError) as error:
        raise DatasetError(f"{path} cannot be read: {error}; {REMEDY}") from error
    if not isinstance(found, dict):
        raise DatasetError(f"{path} holds no table; {REMEDY}")
    return found


def require(where: object, kind: str, needed: Iterable[str], present: Iterable[str]) -> None:
    """Raise a DatasetError unless everything that is needed is present; `kind` is what such a thing is called."""
    there = set(present)
    if missing := [name for name in needed if name not in there]:
        raise DatasetError(f"{where} has no {kind} {', '.join(missing)}; {REMEDY}")


def checked_outcome(found: object, place: str) -> dict[str, Any]:
    """Return the outcome of the episode at a place, with all that a replay needs.

    Raises:
        DatasetError: If something is missing, or of another type.
    """
    if not isinstance(found, dict):
        raise DatasetError(f"{place} has no outcome; {REMEDY}")
    require(f"the outcome of {place}", "field", [*_COUNTS, _DRAWN], found)
    wrong = {name: "an integer from 0 on" for name in _COUNTS if type(found[name]) is not int or found[name] < 0}
    if not isinstance(found[_DRAWN], dict):
        wrong[_DRAWN] = "a table"
    for name, allowed in wrong.items():
        raise DatasetError(f"{name} in the outcome of {place} is {found[name]!r}; allowed: {allowed}; {REMEDY}")
    return found
