"""Where a data set is, given what a user points at."""

from pathlib import Path

from laploop.cli.synthesize import STORE


def dataset_path(given: Path) -> Path:
    """Return the data set inside a folder that `laploop synthesize` wrote; anything else is taken for the data set itself."""
    given = given.expanduser()
    return given / STORE if (given / STORE).is_dir() else given
