"""The table of a depth evaluation: scores of the models against each truth, as JSON, CSV and Markdown."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from laploop.errors import InvalidValueError
from laploop.perception.messages import DepthEstimate
from laploop.perception.metrics import DepthMetrics, MetricsInterval
from laploop.studies.csv_text import csv_text
from laploop.whole_file import whole_file

TABLE_NAME = "depth"
"""Stem of the files that an evaluation leaves: `depth.json`, `depth.csv`, `depth.md`."""

AGAINST = {
    "zivid": "the reference camera's reprojected depth, over all pixels of its validity mask",
    "exact-at-zivid": "exact depth, over the same pixels",
    "exact": "exact depth, over all pixels in the range of depth",
}
"""What a row is measured against, and over which pixels."""

REFERENCE_ROW = "reference"
"""The reference camera itself, measured against exact depth."""

_INTERVALS = ("mae_mm", "abs_rel", "acc_1_1", "acc_1_21", "rmse_mm", "beyond_20mm")


@dataclass(frozen=True, kw_only=True)
class DepthRow:
    """One line of the table."""

    model: str
    against: str
    """One of `AGAINST`."""
    working_distance_mm: str
    """A bin, or `all`."""
    frames: int
    valid_fraction: float
    """Fraction of the pixels that count that the model marks valid."""
    every: DepthMetrics
    """Over every pixel that counts, whether the model marks it valid or not."""
    every_interval: MetricsInterval
    valid: DepthMetrics
    """Over those that the model marks valid."""
    valid_interval: MetricsInterval
    note: str = ""
    """Remark on this line."""

    def flat(self) -> dict[str, object]:
        """Return the line as a flat dictionary; metrics over the pixels that the model marks valid have the prefix `valid_`.

        `_low` and `_high` are the ends of the 95 % interval; what is unknown is None.
        """
        line: dict[str, object] = {
            "model": self.model,
            "against": self.against,
            "working_distance_mm": self.working_distance_mm,
            "frames": self.frames,
        }
        line.update(_with_interval("", self.every, self.every_interval))
        line["valid_share"] = self.valid_fraction
        line.update(_with_interval("valid_", self.valid, self.valid_interval))
        line["note"] = self.note
        # A bin without pixels has no error; neither JSON nor a spreadsheet knows NaN.
        return {name: None if isinstance(value, float) and math.isnan(value) else value for name, value in line.items()}


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthExample:
    """One frame with what every model made of it, for the figures; all arrays are (height, width)."""

    index: int
    """Of the frame in the data set."""
    against: str
    image: NDArray[np.uint8]
    truth_mm: NDArray[np.float32]
    """What the models are measured against."""
    mask: NDArray[np.bool_]
    """Where it counts."""
    estimates: Mapping[str, DepthEstimate]
    """By model, in the order of the table."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthTable:
    """What an evaluation found."""

    dataset: str
    config: Any
    """The evaluation's configuration, a dataclass."""
    tissues: int
    frames: int
    rows: tuple[DepthRow, ...]
    median_ms: Mapping[str, float]
    """Time of one estimate, by model."""
    examples: tuple[DepthExample, ...] = ()

    def row(self, model: str, working_distance_mm: str = "all", *, against: str | None = None) -> DepthRow:
        """Return one line; without `against`, the first that fits.

        Raises:
            InvalidValueError: If there is none.
        """
        for row in self.rows:
            if (row.model, row.working_distance_mm) == (model, working_distance_mm) and against in {None, row.against}:
                return row
        known = sorted({(row.model, row.working_distance_mm, row.against) for row in self.rows})
        raise InvalidValueError("row", (model, working_distance_mm, against), f"one of {known}")

    def models(self, against: str) -> list[str]:
        """Return which models have rows against something, in the order of the table."""
        return list(dict.fromkeys(row.model for row in self.rows if row.against == against))

    def flat_rows(self) -> list[dict[str, object]]:
        """Return all lines as flat dictionaries."""
        return [row.flat() for row in self.rows]

    def error_budget(self) -> dict[str, object] | None:
        """Say how much of the error against the reference camera is the reference's own; None without such rows.

        `reference_mae_mm` is calibration, reprojection and the reference camera together: its depth against exact depth at its
        own pixels. `models` gives for each model its error against the reference, and against exact depth at the same pixels,
        which is the model's own part. Absolute errors do not add up: the whole is at most the sum of the two.
        """
        by_key = {(row.model, row.against): row for row in self.rows if row.working_distance_mm == "all"}
        reference = by_key.get((REFERENCE_ROW, "exact-at-zivid"))
        if reference is None:
            return None
        models = {
            model: {
                "against_zivid_mae_mm": row.every.mae_mm,
                "against_exact_mae_mm": by_key[model, "exact-at-zivid"].every.mae_mm,
            }
            for (model, against), row in by_key.items()
            if against == "zivid" and (model, "exact-at-zivid") in by_key
        }
        return {
            "reference_mae_mm": reference.every.mae_mm,
            "reference_rmse_mm": reference.every.rmse_mm,
            "reference_bias_mm": reference.every.bias_mm,
            "models": models,
        }


def write_table(table: DepthTable, out: Path) -> None:
    """Write `depth.json`, `depth.csv` and `depth.md` into the folder `out`; raises as `write_texts` does."""
    rows = table.flat_rows()
    plain = {
        "dataset": table.dataset,
        "split": table.config.split,
        "pixels_mm": [table.config.nearest_mm, table.config.farthest_mm],
        "tissues": table.tissues,
        "frames": table.frames,
        "median_ms": dict(table.median_ms),
        "error_budget": table.error_budget(),
        "rows": rows,
    }
    texts = {
        ".json": json.dumps(plain, indent=2, allow_nan=False) + "\n",
        ".csv": csv_text(rows[0], (row.values() for row in rows)),
        ".md": markdown_table(table),
    }
    write_texts(out, {f"{TABLE_NAME}{suffix}": text for suffix, text in texts.items()})


def write_texts(out: Path, texts: Mapping[str, str]) -> None:
    """Write files by name into the folder `out`, each atomically.

    Raises:
        OutputError: If the folder cannot be written.
    """
    for name, text in texts.items():
        with whole_file(out / name) as partial:
            partial.write_text(text, encoding="utf-8")


def markdown_table(table: DepthTable) -> str:
    """Return the table as Markdown: one section for each truth, the whole first and the bins of distance after it."""
    sections = []
    for against, meaning in AGAINST.items():
        rows = [row for row in table.rows if row.against == against]
        if not rows:
            continue
        whole = [row for row in rows if row.working_distance_mm == "all"]
        bins = [row for row in rows if row.working_distance_mm != "all"]
        sections.append(
            f"## Against {against}\n\n{meaning[0].upper()}{meaning[1:]}; {table.frames} frames of {table.tissues} tissues.\n"
        )
        sections.append(_metrics_table(whole))
        sections.append("By working distance (median depth of a frame):\n")
        sections.append(_bins_table(bins))
    budget = table.error_budget()
    if budget is not None:
        sections.append(_budget_text(budget))
    notes = {row.model: row.note for row in table.rows if row.note}
    sections += [f"`{model}`: {note}.\n" for model, note in notes.items()]
    sections.append(
        "In brackets the 95 % interval of a bootstrap over tissues. The last two columns count only the pixels that the model "
        "marks valid.\n"
    )
    return "\n".join(sections)


def _metrics_table(rows: Sequence[DepthRow]) -> str:
    head = (
        "| model | MAE mm | AbsRel | Acc(1.1) | Acc(1.1²) | RMSE mm | beyond 20 mm | marked valid | MAE mm, marked valid |\n"
        "|---|---|---|---|---|---|---|---|---|\n"
    )
    return head + "".join(
        f"| {row.model} | {_ranged(row.every, row.every_interval, 'mae_mm', '.2f')} "
        f"| {_ranged(row.every, row.every_interval, 'abs_rel', '.4f')} | {row.every.acc_1_1:.4f} | {row.every.acc_1_21:.4f} "
        f"| {row.every.rmse_mm:.2f} | {100 * row.every.beyond_20mm:.2f} % | {100 * row.valid_fraction:.1f} % "
        f"| {_ranged(row.valid, row.valid_interval, 'mae_mm', '.2f')} |\n"
        for row in rows
    )


def _bins_table(rows: Sequence[DepthRow]) -> str:
    head = "| model | mm | frames | MAE mm | Acc(1.1) | marked valid | MAE mm, marked valid |\n|---|---|---|---|---|---|---|\n"
    return head + "".join(
        f"| {row.model} | {row.working_distance_mm} | {row.frames} | {_ranged(row.every, row.every_interval, 'mae_mm', '.2f')} "
        f"| {row.every.acc_1_1:.4f} | {100 * row.valid_fraction:.1f} % "
        f"| {_ranged(row.valid, row.valid_interval, 'mae_mm', '.2f')} |\n"
        for row in rows
        if row.frames
    )


def _budget_text(budget: Mapping[str, Any]) -> str:
    lines = [
        "## Where the error comes from\n",
        "Calibration, reprojection and the reference camera itself: the reference is",
        f"{budget['reference_mae_mm']:.2f} mm (MAE) from exact depth at its own pixels. Absolute errors do not add",
        "up: the whole is at most the sum of the two parts.\n",
        "| model | whole: against the reference | the model's own: against exact, same pixels |",
        "|---|---|---|",
    ]
    lines += [
        f"| {model} | {parts['against_zivid_mae_mm']:.2f} mm | {parts['against_exact_mae_mm']:.2f} mm |"
        for model, parts in budget["models"].items()
    ]
    return "\n".join(lines) + "\n"


def _ranged(metrics: DepthMetrics, interval: MetricsInterval, name: str, digits: str) -> str:
    value, low, high = (getattr(part, name) for part in (metrics, interval.low, interval.high))
    if math.isnan(value):
        return "-"
    return f"{value:{digits}}" if math.isnan(low) else f"{value:{digits}} ({low:{digits}} to {high:{digits}})"


def _with_interval(prefix: str, metrics: DepthMetrics, interval: MetricsInterval) -> dict[str, object]:
    line: dict[str, object] = {f"{prefix}{name}": value for name, value in asdict(metrics).items()}
    for name in _INTERVALS:
        line[f"{prefix}{name}_low"] = getattr(interval.low, name)
        line[f"{prefix}{name}_high"] = getattr(interval.high, name)
    return line
