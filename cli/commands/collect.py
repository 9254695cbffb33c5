"""`laploop collect`: stripe frames paired with captures of the reference camera, by the paper's automated program."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from laploop.cli.console import ResultTable, progress_bar
from laploop.cli.dataset import PAIRS, SCOPE, verify_dataset
from laploop.cli.output import OutputFolder
from laploop.cli.parsing import Inlined, parse
from laploop.cli.tree_options import FileOptions
from laploop.envs.sensors.optics.presets import preset_name
from laploop.errors import InvalidValueError
from laploop.studies.acquisition.config import AcquisitionConfig

if TYPE_CHECKING:
    from laploop.perception.data.pair_store import PairStore


@dataclass(frozen=True, kw_only=True)
class CollectArguments:
    """Collect stripe frames and the depth of a reference camera, pair by pair, on a simulated bench.

    Writes the data set `pairs.zarr`, its card `card.md` with figures and `statistics.json`, the scope as designed `scope.json`
    (for `laploop predict`), and `summary.json`. When it was stopped, the same command goes on where it was. With `--verify` it
    checks a data set instead. Of a configuration file it takes the tissue, the scope and the optics.
    """

    acquisition: Inlined[AcquisitionConfig] = field(default_factory=AcquisitionConfig)
    calibration: Path | None = None
    """A calibration.json to reproject with; by default the bench is calibrated first."""
    file: Inlined[FileOptions] = field(default_factory=FileOptions)
    out: Path | None = None
    """Folder to write to; made where it does not exist."""
    verify: Path | None = None
    """Check every pair of this data set, and collect nothing."""


def read_arguments(arguments: Sequence[str]) -> CollectArguments:
    """Read the arguments; options come before what the configuration file holds."""
    chosen = parse(CollectArguments, arguments, "collect")
    if (loop := chosen.file.loop()) is not None:
        bench = replace(chosen.acquisition.bench, scope=loop.theatre.scope, preset=preset_name(loop.optics))
        acquisition = replace(chosen.acquisition, bench=bench, tissue=loop.theatre.tissue)
        chosen = parse(CollectArguments, arguments, "collect", replace(chosen, acquisition=acquisition))
    return chosen


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen = read_arguments(arguments)
    if chosen.verify is not None:
        return verify_dataset(chosen.verify)
    if chosen.out is None:
        raise InvalidValueError("--out", None, "a folder for the data set, or --verify and a data set")

    from laploop.perception.calibration.scope_rig import save_design
    from laploop.perception.data.pair_store import PairStore
    from laploop.studies.acquisition.run import collect_pairs  # slow to import

    config = chosen.acquisition
    with OutputFolder(chosen.out, "collect") as folder:
        path = folder.path / PAIRS
        before = PairStore.open(path).count_done() if path.exists() else 0
        collect_pairs(config, path, calibration=chosen.calibration, progress=progress_bar)
        store = PairStore.open(path)
        summary = _describe(store, folder)
        with folder.artefact(SCOPE) as partial:
            save_design(partial, store.optics)
        size_mb = 1e-6 * sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
        results = {
            "pairs_collected_now": len(store) - before,
            "megabytes_per_pair": size_mb / len(store),
            "statistics": summary,
        }
        folder.write_summary(results, config=chosen, seed=config.seed)
    table = ResultTable(f"data set, seed {config.seed}")
    table.row("pairs", str(len(store)), f"{size_mb:.0f} MB")
    for name, count in summary["tissues"].items():
        table.row(f"tissues, {name}", str(count))
    table.row("image with a reference depth", 100.0 * summary["valid_share"]["mean"], "%")
    table.row("reference - exact depth, median magnitude", summary["difference_mad_mm"]["median"], "mm")
    table.show(folder.path)
    return 0


def _describe(store: "PairStore", folder: OutputFolder) -> dict[str, Any]:
    """Write card, figures and statistics, and return the statistics."""
    from laploop.studies.acquisition.card import measure_pairs, summarise, write_card
    from laploop.studies.acquisition.figure import draw_examples, draw_statistics

    statistics = measure_pairs(store)
    summary = summarise(store, statistics)
    with folder.artefact("examples.png") as path:
        draw_examples(store, statistics, path)
    with folder.artefact("statistics.png") as path:
        draw_statistics(statistics, path)
    folder.write_json("statistics.json", summary)
    folder.write_text("card.md", write_card(store, summary))
    return summary
