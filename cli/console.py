"""A command's output: progress on the standard error stream, results on the standard output."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

_LEAST = 1e-3
"""Smallest number that is printed: nobody needs a millionth of a millimetre."""


@contextmanager
def progress_bar(what: str, total: float) -> Iterator[Callable[[float], None]]:
    """Show a progress bar while the block runs, and give the block a function to call with the amount done so far.

    At the end the bar is full: what was done is all there was to do, as when an episode ends early. Where the block raises, the
    bar stays where it was, and says so.
    """
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TextColumn("{task.completed:.4g} of {task.total:.4g}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task(what, total=total)
        try:
            yield lambda completed: progress.update(task, completed=completed)
        except BaseException:
            progress.update(task, description=f"{what}, stopped")
            raise
        done = progress.tasks[0].completed
        progress.update(task, completed=done or total, total=done or total)


def rounded(value: float) -> str:
    """Return a number with at least three figures and no exponent; below a thousandth, only that it is."""
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    if abs(value) < _LEAST:
        return f"below {_LEAST:g}" if value > 0.0 else f"above {-_LEAST:g}"
    text = f"{value:.{max(2 - math.floor(math.log10(abs(value))), 0)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


class ResultTable:
    """A short table of named results."""

    def __init__(self, title: str) -> None:
        self._table = Table(title=title, title_justify="left", show_header=False, title_style="bold")
        self._table.add_column()
        self._table.add_column(justify="right")
        self._table.add_column()

    def row(self, name: str, value: float | str | None, unit: str = "") -> None:
        """Add a result; numbers are rounded, None was not measured."""
        if value is None:
            text = "none"
        elif isinstance(value, str):
            text = value
        else:
            text = rounded(value)
        self._table.add_row(name, text, unit)

    def show(self, folder: Path | None = None) -> None:
        """Print the table and, with the last one of a command, where the artefacts are."""
        console = Console()
        console.print(self._table)
        if folder is not None:
            console.print(f"written to {folder}", highlight=False, soft_wrap=True)
