"""The files of a depth evaluation: its table as JSON, CSV and Markdown."""

import json
import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from laploop.perception.bootstrap import Bounded
from laploop.perception.metrics import DepthMetrics, MetricsInterval
from laploop.perception.reliability import CalibrationBin
from laploop.perception.slip_calibration import SLIP_EDGES, SlipCalibration
from laploop.studies.csv_text import csv_text
from laploop.studies.depth.table import AGAINST, DepthRow, DepthTable, ReliabilityRow
from laploop.whole_file import whole_file

TABLE_NAME = "depth"
"""Stem of the files that an evaluation leaves: `depth.json`, `depth.csv`, `depth.md`."""


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
        "families": table.flat_family_rows(),
        "textures": table.flat_texture_rows(),
        "reliability": table.reliability_rows(),
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
        sections.append(_more_table(whole))
        sections.append("By working distance (median depth of a frame):\n")
        sections.append(_bins_table(bins))
        for title, named in (("By family of shapes", table.family_rows), ("By texture", table.texture_rows)):
            if chosen := [row for row in named if row.against == against]:
                sections += [f"{title}:\n", _bins_table(chosen)]
    budget = table.error_budget()
    if budget is not None:
        sections.append(_budget_text(budget))
    if table.reliability:
        sections.append(_reliability_text(table.reliability))
    notes = {row.model: row.note for row in table.rows if row.note}
    sections += [f"`{model}`: {note}.\n" for model, note in notes.items()]
    sections.append(
        "In brackets the 95 % interval of a bootstrap over tissues. Columns named `marked valid` count only the pixels that "
        "the model marks valid. Lit pixels are those that the projector reaches. Where `phase` is valid, all models are "
        "measured on the same pixels, whatever they mark. A slip is a pixel marked valid that is more than 10 % off, or lies "
        "outside of the range of depth. Edges are the pixels near a step of more than 3 mm.\n"
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


def _more_table(rows: Sequence[DepthRow]) -> str:
    head = (
        "| model | MAE mm, lit | lit, marked valid | MAE mm where `phase` is valid | SqRel mm | within 1.25, 1.25², 1.25³ "
        "| beyond 1, 2, 3 mm | slips per 1000 valid | to the plane mm | normals ° | MAE mm, edges "
        "| MAE mm, away |\n|---|---|---|---|---|---|---|---|---|---|---|---|\n"
    )
    lines = []
    for row in rows:
        every, interval = row.every, row.every_interval
        ratios = ", ".join(f"{value:.4f}" for value in (every.acc_1_25, every.acc_1_5625, every.acc_1_953))
        beyond = ", ".join(f"{100 * value:.1f}" for value in (every.beyond_1mm, every.beyond_2mm, every.beyond_3mm))
        cells = [
            row.model,
            _ranged(row.lit, row.lit_interval, "mae_mm", ".2f"),
            _bounded(row.lit_valid_share, ".3f"),
            _bounded(row.phase_valid_mae_mm, ".2f"),
            _ranged(every, interval, "sq_rel_mm", ".3f"),
            ratios,
            f"{beyond} %",
            _ranged(row.valid, row.valid_interval, "slips_per_1000", ".1f"),
            *(_ranged(every, interval, name, ".2f") for name in ("plane_mm", "normal_deg", "edge_mae_mm", "away_mae_mm")),
        ]
        lines.append(f"| {' | '.join(cells)} |\n")
    return head + "".join(lines)


def _group(row: DepthRow) -> str:
    return next((name for name in (row.family, row.texture) if name != "all"), row.working_distance_mm)


def _reliability_text(rows: Sequence[ReliabilityRow]) -> str:
    lines = [
        "## Confidence\n",
        "AURC is the area under mean absolute error against the fraction of the pixels admitted by falling confidence; the",
        "calibration error is the mean difference of predicted and seen rate within 1 mm.\n",
        "| model | against | family | AURC mm | calibration error | MAE mm of the surest tenth | half | all |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        cells = [_bounded(row.aurc_mm, ".3f"), _bounded(row.calibration_error, ".3f")]
        cells += ["-" if math.isnan(risk) else f"{risk:.3f}" for risk in (row.risk_mm[place] for place in (0, 4, 9))]
        lines.append(f"| {row.model} | {row.against} | {row.family} | {' | '.join(cells)} |")
    text = "\n".join(lines) + "\n"
    if foreseen := [(row, row.slips) for row in rows if row.slips is not None]:
        text += "\n" + _slips_table(foreseen)
    return text


def _slips_table(rows: Sequence[tuple[ReliabilityRow, SlipCalibration]]) -> str:
    bins = " | ".join(f"{1e3 * low:g}-{1e3 * high:g}" for low, high in pairwise(SLIP_EDGES))
    lines = [
        "Predicted and seen slips per 1000 pixels: of all whose depth is known, of those marked valid, and by the predicted",
        "number.\n",
        f"| model | against | family | all | marked valid | {bins} |",
        "|" + "---|" * (4 + len(SLIP_EDGES)),
    ]
    for row, slips in rows:
        cells = (_per_1000(part) for part in (slips.every, slips.valid, *slips.bins))
        lines.append(f"| {row.model} | {row.against} | {row.family} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _per_1000(part: CalibrationBin) -> str:
    return f"{1e3 * part.predicted:.1f} / {1e3 * part.seen:.1f}" if part.pixels else "-"


def _bins_table(rows: Sequence[DepthRow]) -> str:
    head = (
        "| model | group | frames | MAE mm | Acc(1.1) | marked valid | MAE mm, marked valid |\n|---|---|---|---|---|---|---|\n"
    )
    return head + "".join(
        f"| {row.model} | {_group(row)} | {row.frames} | {_ranged(row.every, row.every_interval, 'mae_mm', '.2f')} "
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
    return _bounded(Bounded(value=value, low=low, high=high), digits)


def _bounded(measure: Bounded, digits: str) -> str:
    value, low, high = measure.value, measure.low, measure.high
    if math.isnan(value):
        return "-"
    return f"{value:{digits}}" if math.isnan(low) else f"{value:{digits}} ({low:{digits}} to {high:{digits}})"
