"""A training from data set to weights: what is checked, read and kept, whatever the network."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from laploop.errors import InvalidValueError
from laploop.perception.data.datasets import DepthDataset
from laploop.perception.network_specs import NetworkSpec
from laploop.perception.networks.configs import NetworkConfig
from laploop.perception.training.epoch_log import LOG_NAME, read_rows
from laploop.perception.training.fit import CHECKPOINT_NAME, check_fresh, fit, require_lightning
from laploop.perception.training.recipe import Recipe
from laploop.perception.training.samples import Samples, check_against
from laploop.perception.training.settings import Machine
from laploop.perception.weights import load_weights


@dataclass(frozen=True, kw_only=True)
class TrainingRun:
    """Data, folder and machine of one training, which may have several stages."""

    dataset: DepthDataset
    """With a training and a validation split."""
    out: Path
    """Folder of weights, checkpoint and logs."""
    against: str = "exact"
    """`exact` or `zivid`, the depth to learn."""
    machine: Machine = field(default_factory=Machine)
    limit: int | None = None
    """Largest number of frames of each split."""
    resume: bool = False
    """Go on from the checkpoints in the folder, if there are any, as if the training had never stopped."""
    progress: bool = True
    """Show a bar on the standard error stream."""
    starting: Callable[[], None] = lambda: None
    """Called once everything is checked, before something is written."""

    def __post_init__(self) -> None:
        if self.limit is not None and self.limit < 1:
            raise InvalidValueError("limit", self.limit, "an integer above 0")

    def check(self, config: NetworkConfig) -> None:
        """Check what can be checked before the data are read.

        Raises:
            InvalidValueError: If the data set does not fit the network or shows what is held out, or Lightning is missing.
            OutputError: If `out` holds a training and `resume` is off.
        """
        require_lightning()
        config.check_image(f"{self.dataset.path}", (self.dataset.optics.height, self.dataset.optics.width))
        check_against(self.dataset, self.against)
        self.dataset.check_learnable()
        for checkpoint in (self.out / CHECKPOINT_NAME, *self.out.glob(f"*/{CHECKPOINT_NAME}")):
            check_fresh(checkpoint, resume=self.resume)

    def read(self, recipe: Recipe) -> tuple[Samples, Samples]:
        """Read the frames to learn and those to measure the error on.

        Raises:
            InvalidValueError: If a split is empty or a frame cannot be learned from.
            DatasetError: If the data set is damaged.
        """
        train, val = (
            Samples.read(self.dataset, split, recipe, against=self.against, limit=self.limit, progress=self.progress)
            for split in ("train", "val")
        )
        return train, val

    def fit(self, recipe: Recipe, frames: tuple[Samples, Samples], folder: str = "") -> Path:
        """Train a stage, take its weights over into the recipe's network, and return their path; raises as `fit` does."""
        path = fit(
            recipe,
            *frames,
            self.out / folder,
            machine=self.machine,
            resume=self.resume,
            progress=self.progress,
            starting=self.starting,
        )
        tensors, _ = load_weights(path, recipe.architecture, recipe.network.state_dict())
        recipe.network.load_state_dict(tensors)
        return path


def train_network(spec: NetworkSpec, run: TrainingRun, settings: dict[str, Any]) -> Path:
    """Train a network with the `settings` that its options chose, and return the path of the weights.

    Raises:
        InvalidValueError: If the data set does not fit the network, or Lightning is not installed.
        OutputError: If the folder cannot be written, or holds a training and `resume` is off.
        WeightsError: If a checkpoint in the folder is damaged or of another training.
    """
    run.check(settings["config"])
    path: Path = spec.imported(spec.train)(run, **settings)
    return path


def last_epoch(out: Path) -> dict[str, float]:
    """Return the last line of the log in the folder of a training; nothing if there is no log."""
    rows = list(read_rows(out / LOG_NAME))
    return rows[-1] if rows else {}
