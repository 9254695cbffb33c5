"""`laploop train`: the compact depth network."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from laploop.cli.console import ResultTable
from laploop.cli.dataset import dataset_path
from laploop.cli.output import OutputFolder
from laploop.cli.parsing import parse
from laploop.errors import OutputError
from laploop.perception.networks.compact_unet import CompactConfig
from laploop.perception.training import CHECKPOINT_NAME, LOG_NAME, CompactTraining, train_compact


@dataclass(frozen=True, kw_only=True)
class TrainArguments:
    """Train the compact depth network on a data set that `laploop synthesize` made.

    Writes the weights, a checkpoint and `log.csv` after every epoch, and `summary.json` at the end. When it was stopped, the
    same command with `--resume` goes on where it was.
    """

    training: Annotated[CompactTraining, tyro.conf.arg(name="")] = field(default_factory=CompactTraining)
    network: CompactConfig = field(default_factory=CompactConfig)
    dataset: Path
    """Folder that `laploop synthesize` wrote, or the data set in it."""
    out: Path
    """Folder to write to; made where it does not exist."""
    resume: bool = False
    """Go on from the checkpoint in the folder."""


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen = parse(TrainArguments, arguments, "train")
    dataset = dataset_path(chosen.dataset)
    with OutputFolder(chosen.out, "train") as folder:
        if (folder.path / CHECKPOINT_NAME).exists() and not chosen.resume:
            raise OutputError(f"{folder.path} holds a checkpoint; pass --resume to go on from it, or choose another --out")
        folder.forget_summary()
        weights = train_compact(dataset, folder.path, training=chosen.training, network=chosen.network, resume=chosen.resume)
        last = _last_epoch(folder.path / LOG_NAME)
        results = {"weights": weights.name, **last}
        folder.write_summary(results, config=chosen, seed=chosen.training.seed)
    table = ResultTable("compact network")
    for name, value in last.items():
        table.row(name.replace("_", " "), value)
    table.show(folder.path)
    return 0


def _last_epoch(log: Path) -> dict[str, float]:
    with log.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    return {name: float(value) for name, value in rows[-1].items()}
