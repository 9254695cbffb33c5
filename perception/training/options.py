"""Command-line options of the networks' trainings; the size decides what is left out."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, Protocol

from laploop.configuration import configuration
from laploop.errors import InvalidValueError
from laploop.perception.training.settings import Count, Rate, Schedule, Seed

Named = Mapping[str, Any]
"""Configurations by the name of the size."""


class TrainingOptions(Protocol):
    """A configuration whose fields are a training's options."""

    @property
    def seed(self) -> int:
        """Decides the first weights, the order and the augmentation."""
        ...

    def chosen(self, networks: Named, trainings: Named) -> dict[str, Any]:
        """Return the arguments of the network's training by name: `config`, `training`, and what it alone takes."""
        ...


@configuration
class StageOptions:
    """Options of networks that learn in stages."""

    epochs: Count | None = None
    """Of the last stage."""
    batch: Count | None = None
    """Frames a step."""
    accumulate: Count | None = None
    """Batches whose gradients are added before a step."""
    learning_rate: Rate | None = None
    """Of the last stage, at its start."""
    seed: Seed = 0
    """Decides the first weights, the order and the augmentation."""

    def last(self, schedule: Schedule) -> Schedule:
        """Return the schedule of the last stage with these options."""
        rate = self.learning_rate
        return schedule.changed(
            seed=self.seed, epochs=self.epochs, batch=self.batch, accumulate=self.accumulate, learning_rate=rate
        )

    def earlier(self, schedule: Schedule, epochs: int | None) -> Schedule:
        """Return the schedule of an earlier stage with these options."""
        return schedule.changed(seed=self.seed, epochs=epochs, batch=self.batch, accumulate=self.accumulate)


@configuration
class CompactOptions(StageOptions):
    """Options of `compact`."""

    size: Literal["small", "tiny"] = "small"
    """`small` is the usual one, `tiny` for a try."""
    start: Path | None = None
    """Weights of a trained network to go on from."""

    def chosen(self, networks: Named, trainings: Named) -> dict[str, Any]:
        """Return the arguments of the training by name."""
        usual = trainings[self.size]
        training = replace(usual, schedule=self.last(usual.schedule))
        return {"config": networks[self.size], "training": training, "start": self.start}


@configuration
class SsleOptions(StageOptions):
    """Options of `ssle`."""

    size: Literal["paper", "small", "tiny"] = "small"
    """`paper` with the paper's schedule, `small` for one CPU core and an hour, `tiny` for a try."""
    vq_epochs: Count | None = None
    """Of both VQ-VAEs."""

    def chosen(self, networks: Named, trainings: Named) -> dict[str, Any]:
        """Return the arguments of the training by name."""
        usual = trainings[self.size]
        training = replace(usual, unet=self.last(usual.unet), vq=self.earlier(usual.vq, self.vq_epochs))
        return {"config": networks[self.size], "training": training}


@configuration
class DualUNetOptions(StageOptions):
    """Options of `dual-unet`."""

    size: Literal["paper", "small", "tiny"] = "small"
    """`paper` for a usual U-Net's widths, `small` for one CPU core and an hour, `tiny` for a try."""

    def chosen(self, networks: Named, trainings: Named) -> dict[str, Any]:
        """Return the arguments of the training by name."""
        usual = trainings[self.size]
        return {"config": networks[self.size], "training": replace(usual, schedule=self.last(usual.schedule))}


@configuration
class SslePhaseOptions(StageOptions):
    """Options of `ssle-phase`."""

    size: Literal["small", "tiny"] = "small"
    """`small` is the usual one, `tiny` for a try."""
    reader_epochs: Count | None = None
    """Of the first stage."""
    reader: Path | None = None
    """Weights of a trained `compact`, which is then the first stage and not trained again."""
    start: Path | None = None
    """Weights of a trained network to go on from: its first stage stays as it is, its last learns on."""

    def __post_init__(self) -> None:
        given = [name for name in ("reader_epochs", "reader", "start") if getattr(self, name) is not None]
        if len(given) > 1:
            allowed = f"none with {given[0]}: the first stage is trained, read from a file, or part of a whole network"
            raise InvalidValueError(given[1], getattr(self, given[1]), allowed)

    def chosen(self, networks: Named, trainings: Named) -> dict[str, Any]:
        """Return the arguments of the training by name."""
        usual = trainings[self.size]
        reader = replace(usual.reader, schedule=self.earlier(usual.reader.schedule, self.reader_epochs))
        refiner = replace(usual.refiner, schedule=self.last(usual.refiner.schedule))
        training = replace(usual, reader=reader, refiner=refiner)
        return {"config": networks[self.size], "training": training, "reader": self.reader, "start": self.start}
