"""`laploop train`: the depth networks. Which options there are depends on the model."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path
from typing import Annotated, Any, Generic, Literal, TypeVar

import tyro

from laploop.cli.console import ResultTable
from laploop.cli.output import OutputFolder
from laploop.cli.parsing import Inlined, OutputPath, parse
from laploop.errors import InvalidValueError
from laploop.perception.network_specs import NETWORKS
from laploop.perception.training.options import TrainingOptions
from laploop.perception.training.settings import Machine

Options = TypeVar("Options", bound=TrainingOptions)
_MODELS = "{" + ",".join(NETWORKS.names()) + "}"


@dataclass(frozen=True, kw_only=True)
class TrainArguments(Generic[Options]):
    """Train a depth network, on rendered frames or on collected pairs; `--model NAME --help` lists a network's options.

    Writes the weights, a checkpoint and `log.csv` after every epoch, TensorBoard files, and `summary.json` at the end.
    Networks that learn in stages have a folder for each but the last. When it was stopped, the same command with `--resume`
    goes on after the last whole epoch.
    """

    model: Annotated[str, tyro.conf.arg(metavar=_MODELS)] = "compact"
    """Which network."""
    training: Inlined[Options]
    dataset: tuple[Path, ...]
    """Folder that `laploop synthesize` or `laploop collect` wrote, or the data set in it; several are learned together."""
    out: OutputPath
    against: Literal["exact", "zivid"] = "exact"
    """Which depth to learn: the simulator's, or that of the reference camera after calibration and reprojection."""
    limit: int | None = None
    """Largest number of frames of a split."""
    machine: Machine = field(default_factory=Machine)
    resume: bool = False
    """Go on from the checkpoint in the folder."""


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    spec = NETWORKS.get(model_of(arguments))
    chosen: TrainArguments[TrainingOptions] = parse(arguments_of(spec.name), arguments, "train")

    from laploop.cli.dataset import dataset_path
    from laploop.perception.data.datasets import open_dataset
    from laploop.perception.data.joined_dataset import join
    from laploop.perception.training.run import TrainingRun, last_epoch, train_network

    dataset = join([open_dataset(dataset_path(path)) for path in chosen.dataset])
    settings = spec.settings(chosen.training, height=dataset.optics.height, width=dataset.optics.width)
    with OutputFolder(chosen.out, "train") as folder:
        run = TrainingRun(
            dataset=dataset,
            out=folder.path,
            against=chosen.against,
            machine=chosen.machine,
            limit=chosen.limit,
            resume=chosen.resume,
            starting=folder.forget_summary,
        )
        weights = train_network(spec, run, settings)
        last = last_epoch(folder.path)
        results = {"weights": weights.name, "settings": settings, **last}
        folder.write_summary(results, config=chosen, seed=chosen.training.seed)
    table = ResultTable(chosen.model)
    for name, value in last.items():
        table.row(name.replace("_", " "), value)
    table.show(folder.path)
    return 0


def arguments_of(model: str) -> Any:
    """Return the class that holds the arguments for a network.

    Raises:
        InvalidValueError: If that network cannot be trained.
    """
    spec = NETWORKS.get(model)
    if spec.options is None:
        raise InvalidValueError("model", spec.name, "a network whose entry has a training")
    kind: Any = TrainArguments
    return kind[spec.options]


def model_of(arguments: Sequence[str]) -> str:
    """Return the model that the arguments name, on which the options depend; `compact` where they name none."""
    name = "compact"
    for here, after in zip_longest(arguments, arguments[1:]):
        if here == "--model" and after is not None:
            name = after
        elif here.startswith("--model="):
            name = here.removeprefix("--model=")
    return name
