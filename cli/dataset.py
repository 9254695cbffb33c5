"""Where a data set is, given what a user points at."""

from pathlib import Path

from laploop.cli.commands.synthesize import STORE

PAIRS = "pairs.zarr"
"""Name of the data set inside the folder that `laploop collect` writes."""


def dataset_path(given: Path) -> Path:
    """Return the data set inside a folder that `laploop synthesize` or `laploop collect` wrote.

    Anything else is taken for the data set itself.
    """
    given = given.expanduser()
    for name in (STORE, PAIRS):
        if (given / name).is_dir():
            return given / name
    return given
