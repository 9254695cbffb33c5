"""Trains any recipe through Lightning; can be killed at any moment and resumed at the last finished epoch."""

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import torch

from laploop.errors import InvalidValueError, OutputError, WeightsError
from laploop.perception.training.recipe import Recipe
from laploop.perception.training.samples import Samples
from laploop.perception.weights import architecture_hash

if TYPE_CHECKING:
    import lightning.pytorch as pl

_HARMLESS = (
    r".*does not have many workers.*",
    r".*GPU available but not used.*",
    r".*is smaller than the logging interval.*",
    r".*Checkpoint directory .* exists and is not empty.*",
    r".*LeafSpec.*",
    r".*treespec.*",
    r".*srun.*",
)
"""What Lightning warns of though it is meant: the frames are in memory, the CPU was asked for, few batches an epoch."""


@dataclass(frozen=True, kw_only=True)
class Machine:
    """Where to train; handed to Lightning as it is."""

    accelerator: str = "auto"
    """`cpu`, `gpu`, `auto`."""
    devices: int = 1
    """Processes on each node, one a device."""
    nodes: int = 1
    strategy: str = "auto"
    """`ddp`, for example; `auto` picks it where there are several processes."""
    workers: int = 0
    """Processes that load frames; 0 loads them in the training process, fastest where the augmentation is cheap."""
    tensorboard: bool = True
    """Write TensorBoard's event files as well as the CSV log."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a number is too small.
        """
        for name, least in (("devices", 1), ("nodes", 1), ("workers", 0)):
            if getattr(self, name) < least:
                raise InvalidValueError(name, getattr(self, name), f"{least} or more")

    @property
    def processes(self) -> int:
        """How many train together."""
        return self.devices * self.nodes


def require_lightning() -> None:
    """Say which extra is missing, before anything heavy is done.

    Raises:
        InvalidValueError: If Lightning is not installed.
    """
    if find_spec("lightning") is None:
        raise InvalidValueError("lightning", "not installed", "installed by the extra: pip install 'laploop[train]'")


def fit(
    recipe: Recipe,
    train: Samples,
    val: Samples,
    out: Path,
    *,
    machine: Machine | None = None,
    resume: bool = False,
    progress: bool = True,
) -> Path:
    """Train a recipe and return the path of its weights in the folder `out`.

    After every epoch the folder holds the newest weights, `log.csv`, and a checkpoint; event files for TensorBoard lie in
    `tensorboard/`. On a CPU, a training that was interrupted and resumed ends in the same bits as one that was not.

    Args:
        recipe: Network, loss and schedule.
        train: Frames to learn.
        val: Frames to measure the error on after every epoch.
        out: Folder to write to.
        machine: Devices and processes.
        resume: Go on from the checkpoint in the folder, if there is one.
        progress: Show a bar on the standard error stream.

    Raises:
        InvalidValueError: If Lightning is not installed.
        OutputError: If the folder cannot be written, or holds a checkpoint and `resume` is off.
        WeightsError: If the checkpoint is damaged or of another network.
    """
    require_lightning()
    from lightning.pytorch.utilities.exceptions import SIGTERMException

    from laploop.perception.training.stage_module import CHECKPOINT_NAME, EpochWriter, StageModule

    where = machine or Machine()
    checkpoint = out / CHECKPOINT_NAME
    check_fresh(checkpoint, resume=resume)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write to {out}: {error}") from error
    if checkpoint.exists() and not _unfinished(recipe, checkpoint):
        return out / f"{recipe.name}.safetensors"
    with _quiet(), torch.random.fork_rng(devices=[]):
        trainer = _trainer(recipe, out, where, EpochWriter(recipe, out, progress=progress))
        module = StageModule(recipe, train, val, workers=where.workers, processes=where.processes)
        try:
            trainer.fit(module, ckpt_path=checkpoint if checkpoint.exists() else None)
        except SIGTERMException as error:
            raise KeyboardInterrupt from error
        if trainer.interrupted:
            raise KeyboardInterrupt
    return out / f"{recipe.name}.safetensors"


def check_fresh(checkpoint: Path, *, resume: bool) -> None:
    """Refuse to overwrite a training unasked.

    Raises:
        OutputError: If there is a checkpoint and `resume` is off.
    """
    if checkpoint.exists() and not resume:
        raise OutputError(f"{checkpoint} exists; pass resume to go on from it, or give another folder")


def _unfinished(recipe: Recipe, checkpoint: Path) -> bool:
    """Return whether there are epochs left to do, after a check that the checkpoint is the recipe's."""
    from laploop.perception.training.checkpoint_io import SafetensorsCheckpointIO

    content = SafetensorsCheckpointIO().load_checkpoint(checkpoint)
    wanted = architecture_hash(recipe.architecture, recipe.network.state_dict())
    if content.get("architecture") != wanted:
        raise WeightsError(f"{checkpoint} is of architecture {content.get('architecture')}; allowed: {wanted}")
    # Lightning counts from 0 and saves before it counts on.
    return int(content["epoch"]) + 1 < recipe.schedule.epochs


def _trainer(recipe: Recipe, out: Path, machine: Machine, writer: "pl.Callback") -> "pl.Trainer":
    import lightning.pytorch as pl
    from lightning.pytorch.loggers import TensorBoardLogger

    from laploop.perception.training.checkpoint_io import SafetensorsCheckpointIO

    schedule = recipe.schedule
    logger = TensorBoardLogger(save_dir=out, name="tensorboard", version="") if machine.tensorboard else False
    return pl.Trainer(
        accelerator=machine.accelerator,
        devices=machine.devices,
        num_nodes=machine.nodes,
        strategy=machine.strategy,
        max_epochs=schedule.epochs,
        accumulate_grad_batches=schedule.accumulate,
        gradient_clip_val=schedule.clip_norm or None,
        plugins=[SafetensorsCheckpointIO()],
        callbacks=[writer],
        logger=logger,
        use_distributed_sampler=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        num_sanity_val_steps=0,
        log_every_n_steps=10,
        default_root_dir=out,
    )


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep Lightning's harmless warnings and its banner away."""
    logger = logging.getLogger("lightning.pytorch")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            for message in _HARMLESS:
                warnings.filterwarnings("ignore", message=message)
            yield
    finally:
        logger.setLevel(level)
