"""The log of a training, `log.csv`: a line an epoch."""

import csv
import io
from collections.abc import Iterator
from pathlib import Path

from laploop.whole_file import whole_file

LOG_NAME = "log.csv"


def write_rows(path: Path, rows: list[dict[str, float]]) -> None:
    """Write the log, atomically."""
    if not rows:
        path.unlink(missing_ok=True)
        return
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(rows[-1]))
    writer.writeheader()
    writer.writerows(rows)
    with whole_file(path) as partial:
        partial.write_text(text.getvalue(), encoding="utf-8")


def read_rows(path: Path) -> Iterator[dict[str, float]]:
    """Yield the lines of a log; none if there is no log."""
    if path.is_file():
        with path.open(newline="", encoding="utf-8") as stream:
            for row in csv.DictReader(stream):
                yield {name: float(value) for name, value in row.items()}
