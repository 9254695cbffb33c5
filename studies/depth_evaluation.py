"""How well estimators do on frames of held-out tissues, against exact truth."""

import csv
import io
import json
import os
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import Progress

from laploop.errors import InvalidValueError, OutputError
from laploop.perception.estimators.base import DepthEstimator
from laploop.perception.estimators.oracle import OracleEstimator
from laploop.perception.estimators.registry import make_estimator
from laploop.perception.frame_store import SPLITS, FrameStore
from laploop.perception.geometry import Rig
from laploop.perception.metrics import DepthErrors, DepthMetrics

TABLE_NAME = "depth"
"""Stem of the files that an evaluation leaves: `depth.json`, `depth.csv`, `depth.md`."""


@dataclass(frozen=True, kw_only=True)
class DepthEvaluation:
    """Which frames and pixels count."""

    split: str = "test"
    nearest_mm: float = 60.0
    farthest_mm: float = 140.0
    """Pixels whose true depth lies outside are left out."""
    bins_mm: tuple[float, ...] = (60.0, 80.0, 100.0, 120.0, 140.0)
    """Edges of the bins of working distance, which is the median of a frame's true depth."""
    weights: Path | None = None
    """Replaces the shipped weights of every estimator that has some."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a field lies outside its range.
        """
        if self.split not in SPLITS:
            raise InvalidValueError("split", self.split, f"one of {', '.join(SPLITS)}")
        if not 0.0 < self.nearest_mm < self.farthest_mm:
            raise InvalidValueError("nearest_mm and farthest_mm", (self.nearest_mm, self.farthest_mm), "0 < nearest < farthest")
        if len(self.bins_mm) < 2 or list(self.bins_mm) != sorted(set(self.bins_mm)):
            raise InvalidValueError("bins_mm", self.bins_mm, "two or more rising edges")


@dataclass(frozen=True, kw_only=True)
class DepthRow:
    """One line of the table."""

    estimator: str
    working_distance_mm: str
    """A bin, or `all`."""
    frames: int
    valid_share: float
    """Share of the pixels that the estimator stands by."""
    valid: DepthMetrics
    """Over those pixels."""
    every: DepthMetrics
    """Over every pixel that counts, whether the estimator stands by it or not."""


@dataclass(frozen=True, kw_only=True)
class DepthTable:
    """What an evaluation found."""

    dataset: str
    config: DepthEvaluation
    tissues: int
    frames: int
    rows: tuple[DepthRow, ...]
    median_ms: dict[str, float]
    """Time of one estimate, by estimator."""

    def row(self, estimator: str, working_distance_mm: str = "all") -> DepthRow:
        """Return one line.

        Raises:
            InvalidValueError: If there is none.
        """
        for row in self.rows:
            if (row.estimator, row.working_distance_mm) == (estimator, working_distance_mm):
                return row
        known = sorted({(row.estimator, row.working_distance_mm) for row in self.rows})
        raise InvalidValueError("row", (estimator, working_distance_mm), f"one of {known}")

    def flat_rows(self) -> list[dict[str, object]]:
        """Return the lines as flat dictionaries; what is over every pixel has the prefix `all_`, what is unknown is None."""
        flat: list[dict[str, object]] = []
        for row in self.rows:
            line: dict[str, object] = {
                "estimator": row.estimator,
                "working_distance_mm": row.working_distance_mm,
                "frames": row.frames,
                "valid_share": row.valid_share,
            }
            line.update(asdict(row.valid))
            line.update({f"all_{name}": value for name, value in asdict(row.every).items()})
            # A bin without pixels has no error; neither JSON nor a spreadsheet knows NaN.
            flat.append({name: None if value != value else value for name, value in line.items()})  # noqa: PLR0124
        return flat


def evaluate_depth(
    dataset: Path,
    estimator_names: Sequence[str],
    out: Path | None = None,
    *,
    config: DepthEvaluation | None = None,
    progress: bool = True,
) -> DepthTable:
    """Run estimators by name over a split of a data set; with `out`, write the table there as JSON, CSV and Markdown.

    Raises:
        InvalidValueError: If no estimator is named or the split has no frame.
        UnknownNameError: If an estimator's name is unknown.
        OutputError: If `out` cannot be written.
    """
    chosen = config or DepthEvaluation()
    if not estimator_names:
        raise InvalidValueError("estimator_names", list(estimator_names), "one name or more")
    store = FrameStore.open(dataset)
    rig = Rig.from_optics(store.optics)
    estimators = {
        name: make_estimator(name, rig, chosen.weights if name not in _WITHOUT_WEIGHTS else None) for name in estimator_names
    }
    indices = store.indices(chosen.split)
    counters = {name: _Counters(chosen) for name in estimators}
    with Progress(console=Console(stderr=True), disable=not progress) as bar:
        task = bar.add_task("evaluating", total=len(indices))
        for index in indices:
            _count_frame(store, int(index), estimators, counters)
            bar.update(task, advance=1)
    table = DepthTable(
        dataset=dataset.name,
        config=chosen,
        tissues=len(np.unique(store.tissue_seed[indices])),
        frames=len(indices),
        rows=tuple(row for name, counter in counters.items() for row in counter.rows(name)),
        median_ms={name: float(np.median(counter.times_ms)) for name, counter in counters.items()},
    )
    if out is not None:
        write_table(table, out)
    return table


_WITHOUT_WEIGHTS = ("oracle", "phase")


class _Counters:
    """Errors of one estimator, overall and by bin."""

    def __init__(self, config: DepthEvaluation) -> None:
        edges = config.bins_mm
        self.config = config
        self.names = ["all", *(f"{low:g}-{high:g}" for low, high in pairwise(edges))]
        self.valid = [DepthErrors() for _ in self.names]
        self.every = [DepthErrors() for _ in self.names]
        self.frames = [0 for _ in self.names]
        self.times_ms: list[float] = []

    def places(self, working_distance_mm: float) -> list[int]:
        """Return which counters a frame belongs to."""
        place = int(np.searchsorted(self.config.bins_mm, working_distance_mm, side="right"))
        return [0, place] if 1 <= place < len(self.names) else [0]

    def rows(self, estimator: str) -> list[DepthRow]:
        """Return the lines of the table."""
        rows = []
        for name, frames, valid, every in zip(self.names, self.frames, self.valid, self.every, strict=True):
            share = valid.metrics().pixels / max(1, every.metrics().pixels)
            rows.append(
                DepthRow(
                    estimator=estimator,
                    working_distance_mm=name,
                    frames=frames,
                    valid_share=share,
                    valid=valid.metrics(),
                    every=every.metrics(),
                )
            )
        return rows


def _count_frame(store: FrameStore, index: int, estimators: dict[str, DepthEstimator], counters: dict[str, _Counters]) -> None:
    image, truth = store.image(index), store.depth_mm(index)
    distance = float(np.nanmedian(truth)) if np.isfinite(truth).any() else float("nan")
    for name, estimator in estimators.items():
        counter = counters[name]
        if isinstance(estimator, OracleEstimator):
            estimator.see_truth(truth)
        began = time.perf_counter()
        estimate = estimator.estimate(image)
        counter.times_ms.append(1e3 * (time.perf_counter() - began))
        counted = (truth >= counter.config.nearest_mm) & (truth <= counter.config.farthest_mm)
        for place in counter.places(distance):
            counter.frames[place] += 1
            counter.valid[place].add(estimate.depth_mm, truth, counted & estimate.valid)
            counter.every[place].add(estimate.depth_mm, truth, counted)


def write_table(table: DepthTable, out: Path) -> None:
    """Write `depth.json`, `depth.csv` and `depth.md` into the folder `out`, each whole or not at all.

    Raises:
        OutputError: If the folder cannot be written.
    """
    rows = table.flat_rows()
    lines = io.StringIO()
    writer = csv.DictWriter(lines, fieldnames=list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)
    plain = {
        "dataset": table.dataset,
        "split": table.config.split,
        "pixels_mm": [table.config.nearest_mm, table.config.farthest_mm],
        "tissues": table.tissues,
        "frames": table.frames,
        "median_ms": table.median_ms,
        "rows": rows,
    }
    texts = {".json": json.dumps(plain, indent=2) + "\n", ".csv": lines.getvalue(), ".md": markdown_table(table)}
    try:
        out.mkdir(parents=True, exist_ok=True)
        for suffix, text in texts.items():
            partial = out / f"{TABLE_NAME}{suffix}.{os.getpid()}.partial"
            partial.write_text(text)
            partial.replace(out / f"{TABLE_NAME}{suffix}")
    except OSError as error:
        raise OutputError(f"cannot write the table to {out}: {error}") from error


def markdown_table(table: DepthTable) -> str:
    """Return the table as Markdown; errors are over the pixels that the estimator calls valid unless it says `all pixels`."""
    head = (
        "| estimator | working distance mm | frames | valid | MAE mm | RMSE mm | AbsRel | within 10 % | MAE mm, all pixels |\n"
    )
    rule = "|---|---|---|---|---|---|---|---|---|\n"
    body = "".join(
        f"| {row.estimator} | {row.working_distance_mm} | {row.frames} | {row.valid_share:.1%} | {row.valid.mae_mm:.3f} "
        f"| {row.valid.rmse_mm:.3f} | {row.valid.abs_rel:.4f} | {row.valid.acc_1_1:.4f} | {row.every.mae_mm:.3f} |\n"
        for row in table.rows
    )
    return head + rule + body
