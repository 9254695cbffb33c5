"""Data sets as a user points at them: where they are, and whether they are whole."""

from pathlib import Path

from rich.console import Console

from laploop.cli.console import progress_bar
from laploop.errors import InvalidValueError

FRAMES = "frames.zarr"
"""Name of the data set inside the folder that `laploop synthesize` writes."""
PAIRS = "pairs.zarr"
"""The same of `laploop collect`."""
SCOPE = "scope.json"
"""The scope of either, as designed, in the form of a calibration file."""

_SHOWN_PROBLEMS = 50


def dataset_path(given: Path) -> Path:
    """Return the data set inside a folder that `laploop synthesize` or `laploop collect` wrote.

    Anything else is taken for the data set itself.
    """
    try:
        folder = given.expanduser()
        return next((folder / name for name in (FRAMES, PAIRS) if (folder / name).is_dir()), folder)
    except (OSError, RuntimeError) as error:
        raise InvalidValueError("path of the data set", given, f"one that can be read ({error})") from error


def verify_dataset(given: Path) -> int:
    """Check every frame of a data set, list what is wrong with it, and return the exit status."""
    from laploop.perception.data.check import check_dataset
    from laploop.perception.data.datasets import open_dataset

    path = dataset_path(given)
    store = open_dataset(path)
    with progress_bar(f"{store.NOUN}s checked", len(store)) as report:
        result = check_dataset(store, report=report)
    console = Console()
    for problem in result.problems[:_SHOWN_PROBLEMS]:
        console.print(problem, highlight=False, soft_wrap=True)
    if len(result.problems) > _SHOWN_PROBLEMS:
        console.print(f"and {len(result.problems) - _SHOWN_PROBLEMS} more", highlight=False)
    verdict = "nothing wrong" if result.passed else f"{len(result.problems)} problems"
    console.print(f"{path}: {result.done} of {result.frames} {store.NOUN}s done, {verdict}", highlight=False, soft_wrap=True)
    return 0 if result.passed else 1
