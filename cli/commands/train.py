"""`laploop train`: the depth networks. Which options there are depends on the model."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path
from typing import Annotated, Literal

import tyro

from laploop.cli.commands.train_staged import STAGED_MODELS, last_epoch, train_staged
from laploop.cli.console import ResultTable
from laploop.cli.dataset import dataset_path
from laploop.cli.output import OutputFolder
from laploop.cli.parsing import parse
from laploop.errors import OutputError, UnknownNameError
from laploop.perception.networks.compact_unet import CompactConfig
from laploop.perception.training import CHECKPOINT_NAME, LOG_NAME, CompactTraining, train_compact


@dataclass(frozen=True, kw_only=True)
class TrainArguments:
    """Train a depth network; these are the options of `--model compact`, on a data set that `laploop synthesize` made.

    `--model ssle --help`, `--model dual-unet --help` and `--model ssle-phase --help` list those of the other models.

    Writes the weights, a checkpoint and `log.csv` after every epoch, and `summary.json` at the end. When it was stopped, the
    same command with `--resume` goes on where it was.
    """

    model: Literal["compact"] = "compact"
    """Which network."""
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
    if model_of(arguments) != "compact":
        return train_staged(arguments)
    chosen = parse(TrainArguments, arguments, "train")
    dataset = dataset_path(chosen.dataset)
    with OutputFolder(chosen.out, "train") as folder:
        if (folder.path / CHECKPOINT_NAME).exists() and not chosen.resume:
            raise OutputError(f"{folder.path} holds a checkpoint; pass --resume to go on from it, or choose another --out")
        folder.forget_summary()
        weights = train_compact(dataset, folder.path, training=chosen.training, network=chosen.network, resume=chosen.resume)
        last = last_epoch(folder.path / LOG_NAME)
        results = {"weights": weights.name, **last}
        folder.write_summary(results, config=chosen, seed=chosen.training.seed)
    table = ResultTable("compact network")
    for name, value in last.items():
        table.row(name.replace("_", " "), value)
    table.show(folder.path)
    return 0


def model_of(arguments: Sequence[str]) -> str:
    """Return which model is asked for, since the options depend on it; `compact` where none is.

    Raises:
        UnknownNameError: If there is no such model.
    """
    name = "compact"
    for here, after in zip_longest(arguments, arguments[1:]):
        if here == "--model" and after is not None:
            name = after
        elif here.startswith("--model="):
            name = here.removeprefix("--model=")
    models = ("compact", *STAGED_MODELS)
    if name not in models:
        raise UnknownNameError("model", name, models)
    return name
