"""A command's output: progress on the standard error stream, results on the standard output."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table


@contextmanager
def progress_bar(what: str, total: float) -> Iterator[Callable[[float], None]]:
    """Show a progress bar while the block runs, and give the block a function to call with the amount done so far."""
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
        yield lambda completed: progress.update(task, completed=completed)


class ResultTable:
    """A short table of named results."""

    def __init__(self, title: str) -> None:
        self._table = Table(title=title, title_justify="left", show_header=False, title_style="bold")
        self._table.add_column()
        self._table.add_column(justify="right")
        self._table.add_column()

    def row(self, name: str, value: float | str | None, unit: str = "") -> None:
        """Add a result; numbers are rounded to three figures, None was not measured."""
        if value is None:
            text = "none"
        elif isinstance(value, str):
            text = value
        else:
            text = f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
        self._table.add_row(name, text, unit)

    def show(self, folder: Path | None = None) -> None:
        """Print the table and, with the last one of a command, where the artefacts are."""
        console = Console()
        console.print(self._table)
        if folder is not None:
            console.print(f"written to {folder}", highlight=False, soft_wrap=True)
