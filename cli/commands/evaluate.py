"""`laploop evaluate`: models against exact depth and against the reference camera, on held-out tissues."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from laploop.cli.console import ResultTable
from laploop.cli.output import OutputFolder
from laploop.cli.parsing import Inlined, OutputPath, parse
from laploop.configuration import configuration
from laploop.studies.depth.config import DepthEvaluation, RobustnessConfig

if TYPE_CHECKING:
    from laploop.studies.depth.robustness import RobustnessRow
    from laploop.studies.depth.table import DepthTable


@configuration
class EvaluateArguments:
    """Measure models on tissues that were not in training, against exact depth and against the reference camera.

    Writes `depth.csv`, `depth.md`, `depth.json`, figures, with --robustness `robustness.csv`, `robustness.md`, `jitter.csv` and
    `jitter.md`, and `summary.json`.
    """

    evaluation: Inlined[DepthEvaluation] = DepthEvaluation()
    dataset: Path
    """Folder that `laploop synthesize` or `laploop collect` wrote, or the data set in it."""
    models: tuple[str, ...] = ("phase", "compact")
    """Which models, separated by commas or spaces; dpt and depth-anything are compared raw and fitted. An estimator of your own
    is `module:Class`."""
    robustness: bool = False
    """Also render other conditions than the nominal one (half the light, a large tool, ...), and measure the models there;
    and still scenes with changing noise, and measure how much depth jitters."""
    conditions: RobustnessConfig = RobustnessConfig()
    """How many frames, for --robustness."""
    out: OutputPath

    @property
    def model_names(self) -> tuple[str, ...]:
        """The models one by one."""
        return tuple(name for part in self.models for name in part.split(",") if name)


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen = parse(EvaluateArguments, arguments, "evaluate")

    from laploop.cli.dataset import dataset_path
    from laploop.perception.data.datasets import open_dataset
    from laploop.studies.depth.evaluation import evaluate_depth
    from laploop.studies.depth.table_files import write_table

    path = dataset_path(chosen.dataset)
    rows: list[RobustnessRow] = []
    with OutputFolder(chosen.out, "evaluate") as folder:
        found = evaluate_depth(path, chosen.model_names, config=chosen.evaluation)
        folder.forget_summary()
        write_table(found, folder.path)
        _draw(found, folder)
        results = {
            "tissues": found.tissues,
            "frames": found.frames,
            "median_ms": found.median_ms,
            "error_budget": found.error_budget(),
            "rows": found.flat_rows(),
            "families": found.flat_family_rows(),
            "textures": found.flat_texture_rows(),
            "reliability": found.reliability_rows(),
        }
        if chosen.robustness:
            from laploop.studies.depth.jitter import measure_jitter, write_jitter
            from laploop.studies.depth.robustness import measure_robustness, write_robustness

            scope, range_mm = open_dataset(path).optics, (chosen.evaluation.nearest_mm, chosen.evaluation.farthest_mm)
            options: dict[str, Any] = {"config": chosen.conditions, "weights": chosen.evaluation.weights, "range_mm": range_mm}
            rows = measure_robustness(chosen.model_names, scope, **options)
            write_robustness(rows, folder.path)
            still = measure_jitter(chosen.model_names, scope, **options)
            write_jitter(still, folder.path)
            results["robustness"] = [row.flat() for row in rows]
            results["jitter"] = [row.flat() for row in still]
        folder.write_summary(results, config=chosen, seed=chosen.evaluation.bootstrap_seed)
    _show(found, rows, folder.path)
    return 0


def _draw(found: "DepthTable", folder: OutputFolder) -> None:
    """Draw what there is to draw; the examples are of the first model that is not the truth itself."""
    from laploop.studies.depth.figure import draw_comparison, draw_distance, draw_examples
    from laploop.studies.depth.table import AGAINST

    if found.examples and any(example.mask.any() for example in found.examples):
        with folder.artefact("depth_comparison.png") as partial:
            draw_comparison(found, partial)
        with folder.artefact("depth_examples.png") as partial:
            names = list(found.examples[0].estimates)
            draw_examples(found, next((name for name in names if name != "oracle"), names[0]), partial)
    for against in AGAINST:
        if found.models(against):
            with folder.artefact(f"depth_distance_{against}.png") as partial:
                draw_distance(found, against, partial)


def _show(found: "DepthTable", rows: "Sequence[RobustnessRow]", path: Path) -> None:
    table = ResultTable(f"{found.frames} frames of {found.tissues} tissues: mean absolute error")
    shown: list[tuple[Any, str]] = [(row, f"against {row.against}") for row in found.rows if row.working_distance_mm == "all"]
    for row, condition in [*shown, *((row, row.condition) for row in rows)]:
        valid = f"{row.valid.mae_mm:.3g} mm on the {row.valid_fraction:.1%} marked valid"
        table.row(f"{row.model}, {condition}", row.every.mae_mm, f"mm; {valid}")
    table.show(path)
