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

    def __init__(self, folder: Path, *, resume: bool = False) -> None:
        """Begin a curve, or go on from the one in the folder.

        Args:
            folder: Where it is written to; made if it is missing.
            resume: Whether what was trained before counts, if anything was.

        Raises:
            InvalidValueError: If what is there is no curve.
        """
        self._path = folder / CURVE
        self.rows = _rows(self._path) if resume and self._path.is_file() else []
        none = CurveRow(steps=0, wall_s=0.0, cpu_s=0.0, total_return=0.0, length=0.0, success=0.0)
        self._before = self.rows[-1] if self.rows else none
        self._watch = Stopwatch()

    @property
    def wall_s(self) -> float:
        """Seconds of training by the clock on the wall."""
        return self._before.wall_s + self._watch.wall_s

    @property
    def cpu_s(self) -> float:
        """Seconds of training of all threads of this process, and of those that went on before it."""
        return self._before.cpu_s + self._watch.cpu_s

    def steps(self, new: int) -> int:
        """Return the steps of the whole training after a number of new ones."""
        return self._before.steps + new

    def add(self, *, steps: int, total_return: float, length: float, success: float) -> None:
        """Add an episode that ended after a number of new steps."""
        self.rows.append(
            CurveRow(
                steps=self.steps(steps),
                wall_s=round(self.wall_s, 2),
                cpu_s=round(self.cpu_s, 2),
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
    rows = _rows(folder / CURVE)
    return {field.name: np.array([getattr(row, field.name) for row in rows], np.float64) for field in fields(CurveRow)}


def _rows(path: Path) -> list[CurveRow]:
    names = [field.name for field in fields(CurveRow)]
    with path.open(encoding="utf-8", newline="") as stream:
        found = list(csv.DictReader(stream))
    try:
        return [
            CurveRow(steps=int(row["steps"]), **{name: float(row[name]) for name in names if name != "steps"}) for row in found
        ]
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InvalidValueError("curve", str(path), f"a table with {', '.join(names)}") from error
