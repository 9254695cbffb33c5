"""`laploop train --model ssle|dual-unet|ssle-phase`: the networks that are trained through Lightning."""

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from laploop.cli.console import ResultTable
from laploop.cli.dataset import dataset_path
from laploop.cli.output import OutputFolder
from laploop.cli.parsing import parse
from laploop.errors import InvalidValueError, OutputError
from laploop.perception.data.datasets import DepthDataset, open_dataset
from laploop.perception.data.joined_dataset import join
from laploop.perception.training.fit import Machine, require_lightning
from laploop.perception.training.recipe import Schedule

LOG_NAME = "log.csv"


@dataclass(frozen=True, kw_only=True)
class StagedArguments:
    """Train a depth network through Lightning, on rendered frames or on collected pairs.

    Writes the weights, a checkpoint and `log.csv` after every epoch, TensorBoard files, and `summary.json` at the end.
    `ssle` has three stages: the VQ-VAEs of images and of depths, in folders of their own, then the U-Net; `ssle-phase` has two,
    the reader of the phase, in a folder of its own, then the refiner. When it was stopped, the same command with `--resume`
    goes on after the last whole epoch. Whatever is left out is what the size says.
    """

    model: Literal["ssle", "dual-unet", "ssle-phase"]
    """Which network."""
    dataset: tuple[Path, ...]
    """Folder that `laploop synthesize` or `laploop collect` wrote, or the data set in it; several are learned together."""
    out: Path
    """Folder to write to; made where it does not exist."""
    size: Literal["paper", "small", "tiny"] = "small"
    """`paper` with the paper's schedule, `small` for one CPU core and an hour, `tiny` for a try. `ssle-phase` has
    one size."""
    against: Literal["exact", "zivid"] = "exact"
    """Which depth to learn: the simulator's, or that of the reference camera after calibration and reprojection."""
    epochs: int | None = None
    """Of the last stage."""
    vq_epochs: int | None = None
    """Of both VQ-VAEs of `ssle`."""
    reader_epochs: int | None = None
    """Of the first stage of `ssle-phase`."""
    reader: Path | None = None
    """Weights of a trained first stage of `ssle-phase`, which is then not trained again."""
    start: Path | None = None
    """Weights of a trained `ssle-phase` to go on from: its first stage stays as it is, its last learns on."""
    batch: int | None = None
    accumulate: int | None = None
    """Batches whose gradients are added before a step."""
    learning_rate: float | None = None
    """Of the last stage, at its start."""
    seed: int = 0
    """Decides the first weights, the order and the augmentation."""
    limit: int | None = None
    """Use at most so many frames of a split."""
    machine: Machine = field(default_factory=Machine)
    resume: bool = False
    """Go on from the checkpoint in the folder."""

    def check(self) -> None:
        """Check what belongs to one model alone; after parsing, so that it is told like every other bad value.

        Raises:
            InvalidValueError: If another model is asked for, or a count is below 1.
        """
        for model, names in (("ssle", ("vq_epochs",)), ("ssle-phase", ("reader_epochs", "reader", "start"))):
            for name in names:
                if getattr(self, name) is not None and self.model != model:
                    raise InvalidValueError(name, getattr(self, name), f"only with --model {model}")
        if self.limit is not None and self.limit < 1:
            raise InvalidValueError("limit", self.limit, "1 or more")

    def changed(self, schedule: Schedule) -> Schedule:
        """Return a last stage's schedule with what was asked for."""
        names = ("epochs", "batch", "accumulate", "learning_rate")
        changes: dict[str, Any] = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        if self.learning_rate is not None:
            share = schedule.final_learning_rate / schedule.learning_rate
            changes["final_learning_rate"] = share * self.learning_rate
        return replace(schedule, seed=self.seed, **changes)

    def changed_first(self, schedule: Schedule, epochs: int | None) -> Schedule:
        """Return an earlier stage's schedule with what was asked for."""
        asked = {"epochs": epochs, "batch": self.batch, "accumulate": self.accumulate}
        changes: dict[str, Any] = {name: value for name, value in asked.items() if value is not None}
        return replace(schedule, seed=self.seed, **changes)


def train_staged(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen = parse(StagedArguments, arguments, "train")
    chosen.check()
    require_lightning()
    dataset = join([open_dataset(dataset_path(path)) for path in chosen.dataset])
    train, settings = _MODELS[chosen.model](chosen, dataset)
    with OutputFolder(chosen.out, "train") as folder:
        if (folder.path / "checkpoint.safetensors").exists() and not chosen.resume:
            raise OutputError(f"{folder.path} holds a checkpoint; pass --resume to go on from it, or choose another --out")
        folder.forget_summary()
        options = {"against": chosen.against, "machine": chosen.machine, "limit": chosen.limit, "resume": chosen.resume}
        weights = train(dataset, folder.path, **settings, **options)
        last = last_epoch(folder.path / LOG_NAME)
        results = {"weights": weights.name, "settings": settings, **last}
        folder.write_summary(results, config=chosen, seed=chosen.seed)
    table = ResultTable(f"{chosen.model}, {chosen.size}")
    for name, value in last.items():
        table.row(name.replace("_", " "), value)
    table.show(folder.path)
    return 0


def last_epoch(log: Path) -> dict[str, float]:
    """Return the last line of a log."""
    with log.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    return {name: float(value) for name, value in rows[-1].items()}


Plan = tuple[Callable[..., Path], dict[str, Any]]
"""The function that trains, and its configuration."""


def _ssle(chosen: StagedArguments, dataset: DepthDataset) -> Plan:
    from laploop.perception.networks.ssle_network import SsleConfig
    from laploop.perception.training.ssle import train_ssle
    from laploop.perception.training.ssle_settings import SsleTraining

    height, width = dataset.optics.height, dataset.optics.width
    named = SsleTraining.named(chosen.size)
    training = replace(named, unet=chosen.changed(named.unet), vq=chosen.changed_first(named.vq, chosen.vq_epochs))
    return train_ssle, {"config": SsleConfig.named(chosen.size, height=height, width=width), "training": training}


def _dual_unet(chosen: StagedArguments, dataset: DepthDataset) -> Plan:
    from laploop.perception.networks.dual_unet import DualUNetConfig
    from laploop.perception.training.dual_unet import DualUNetTraining, train_dual_unet

    height, width = dataset.optics.height, dataset.optics.width
    named = DualUNetTraining.named(chosen.size)
    training = replace(named, schedule=chosen.changed(named.schedule))
    return train_dual_unet, {"config": DualUNetConfig.named(chosen.size, height=height, width=width), "training": training}


def _ssle_phase(chosen: StagedArguments, dataset: DepthDataset) -> Plan:
    from laploop.perception.networks.ssle_phase import SslePhaseConfig
    from laploop.perception.training.ssle_phase import SslePhaseTraining, train_ssle_phase

    usual = SslePhaseTraining()
    training = replace(
        usual, refiner=chosen.changed(usual.refiner), reader=chosen.changed_first(usual.reader, chosen.reader_epochs)
    )
    config = SslePhaseConfig(height=dataset.optics.height, width=dataset.optics.width)
    return train_ssle_phase, {"config": config, "training": training, "reader": chosen.reader, "start": chosen.start}


_MODELS: dict[str, Callable[[StagedArguments, DepthDataset], Plan]] = {
    "ssle": _ssle,
    "dual-unet": _dual_unet,
    "ssle-phase": _ssle_phase,
}

STAGED_MODELS: tuple[str, ...] = tuple(_MODELS)
"""Names of the models trained here."""
