"""`laploop import-pairs`: a bench's own pictures and reference clouds become a data set."""

from collections.abc import Sequence

import numpy as np

from laploop.cli.console import ResultTable, progress_bar
from laploop.cli.dataset import PAIRS
from laploop.cli.output import OutputFolder
from laploop.cli.parsing import Inlined, OutputPath, parse
from laploop.configuration import configuration
from laploop.perception.data.pair_import import PairImport


@configuration
class ImportPairsArguments:
    """Make a data set of your own pictures and clouds of a reference camera, for `laploop train` and `laploop evaluate`.

    The folder holds `pairs.csv` with the columns image, cloud, split, scene and perhaps tool (docs/own_images.md). Every file
    is checked before anything is written; lens distortion is taken out; the clouds are reprojected into the scope's image.
    Writes the data set `pairs.zarr` and `summary.json`. When it was stopped, the same command goes on where it was.
    """

    pairs: Inlined[PairImport]
    out: OutputPath


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen = parse(ImportPairsArguments, arguments, "import-pairs")

    from laploop.perception.data.pair_import import PairImporter

    with OutputFolder(chosen.out, "import-pairs") as folder:
        importer = PairImporter(chosen.pairs)
        with progress_bar("pairs checked", len(importer)) as report:
            importer.check(report)
        with progress_bar("pairs", len(importer)) as report:
            store = importer.write(folder.path / PAIRS, report)
        folder.forget_summary()
        scenes = store.tissues_by_split()
        share = float(np.mean([np.isfinite(store.reference_depth_mm(index)).mean() for index in range(len(store))]))
        results = {"pairs": len(store), "scenes": scenes, "reference_share": share}
        folder.write_summary(results, config=chosen, seed=None)
    table = ResultTable("imported data set")
    table.row("pairs", str(len(store)))
    for name, count in scenes.items():
        table.row(f"scenes, {name}", str(count))
    table.row("image with a reference depth", 100.0 * share, "%")
    table.show(folder.path)
    return 0
