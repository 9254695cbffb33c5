"""`laploop evaluate`: estimators against exact depth on held-out tissues."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from laploop.cli.console import ResultTable
from laploop.cli.dataset import dataset_path
from laploop.cli.output import OutputFolder
from laploop.cli.parsing import parse
from laploop.perception.estimators.registry import ESTIMATOR_NAMES
from laploop.studies.depth_evaluation import DepthEvaluation, evaluate_depth, write_table


@dataclass(frozen=True, kw_only=True)
class EvaluateArguments:
    """Measure estimators against exact depth, on tissues that were not in training.

    Writes `depth.csv`, `depth.md`, `depth.json` and `summary.json`.
    """

    evaluation: Annotated[DepthEvaluation, tyro.conf.arg(name="")] = field(default_factory=DepthEvaluation)
    dataset: Path
    """Folder that `laploop synthesize` wrote, or the data set in it."""
    estimators: tuple[str, ...] = ESTIMATOR_NAMES
    """Which estimators."""
    out: Path
    """Folder to write to; made where it does not exist."""


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen = parse(EvaluateArguments, arguments, "evaluate")
    with OutputFolder(chosen.out, "evaluate") as folder:
        found = evaluate_depth(dataset_path(chosen.dataset), chosen.estimators, config=chosen.evaluation)
        folder.forget_summary()
        write_table(found, folder.path)
        results = {
            "tissues": found.tissues,
            "frames": found.frames,
            "median_ms": found.median_ms,
            "rows": found.flat_rows(),
        }
        folder.write_summary(results, config=chosen, seed=None)
    table = ResultTable(f"{found.frames} frames of {found.tissues} tissues, valid pixels")
    for name in chosen.estimators:
        row = found.row(name)
        table.row(
            name, row.valid.mae_mm, f"mm mean absolute error, {row.valid_share:.1%} valid, {found.median_ms[name]:.1f} ms"
        )
    table.show(folder.path)
    return 0
