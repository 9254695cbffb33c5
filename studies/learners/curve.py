"""Curves of learning: a row an episode, kept on disk while a learner is at work."""

import csv
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import numpy as np

from laploop.arrays import Array
from laploop.errors import InvalidValueError
from laploop.studies.csv_text import csv_text
from laploop.studies.learners.evaluation import Stopwatch
from laploop.whole_file import whole_file

CURVE = "curve.csv"


@dataclass(frozen=True, kw_only=True)
class CurveRow:
    """An episode of a training, by its end, or the mean of several."""

    steps: int
    """Of the training so far."""
    wall_s: float
    cpu_s: float
    total_return: float
    length: float
    success: float
    """1 or 0; NaN where the learner does not tell."""


class Curve:
    """The episodes of a training so far."""

    def __init__(self, folder: Path) -> None:
        """Take the folder to write to; it is made if it is missing."""
        self.rows: list[CurveRow] = []
        self._path = folder / CURVE
        self.watch = Stopwatch()

    def add(self, *, steps: int, total_return: float, length: float, success: float) -> None:
        """Add an episode."""
        self.rows.append(
            CurveRow(
                steps=steps,
                wall_s=round(self.watch.wall_s, 2),
                cpu_s=round(self.watch.cpu_s, 2),
                total_return=round(total_return, 4),
                length=length,
                success=success,
            )
        )

    def write(self) -> None:
        """Write all rows."""
        with whole_file(self._path) as partial:
            partial.write_text(csv_text([field.name for field in fields(CurveRow)], map(astuple, self.rows)), encoding="utf-8")


def read_curve(folder: Path) -> dict[str, Array]:
    """Return the columns of a curve, by name.

    Raises:
        InvalidValueError: If it is none.
    """
    path = folder / CURVE
    with path.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    try:
        return {field.name: np.array([float(row[field.name]) for row in rows]) for field in fields(CurveRow)}
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidValueError(
            "curve", str(path), f"a table with {', '.join(field.name for field in fields(CurveRow))}"
        ) from error
