"""Trains any recipe through Lightning; can be killed at any moment and resumed at the last finished epoch."""

import logging
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import torch

from laploop.configuration import to_plain
from laploop.errors import InvalidValueError, OutputError, WeightsError
from laploop.perception.training.recipe import Recipe
from laploop.perception.training.samples import Samples
from laploop.perception.training.settings import Machine
from laploop.perception.weights import architecture_hash, difference

if TYPE_CHECKING:
    import lightning.pytorch as pl

CHECKPOINT_NAME = "checkpoint.safetensors"

_HARMLESS = (
    r".*does not have many workers.*",
    r".*GPU available but not used.*",
    r".*is smaller than the logging interval.*",
    r".*Checkpoint directory .* exists and is not empty.*",
    r".*LeafSpec.*",
    r".*treespec.*",
    r".*srun.*",
)
"""What Lightning warns of although it is intended: the frames are in memory, the CPU is chosen, an epoch has few batches."""


def require_lightning() -> None:
    """Raise an `InvalidValueError`, which names the missing extra, before anything heavy is done."""
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
    starting: Callable[[], None] = lambda: None,
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
        resume: Go on from the checkpoint in the folder, if there is one. The number of epochs may be another one.
        progress: Show a bar on the standard error stream.
        starting: Called once everything is checked, before something is written.

    Raises:
        InvalidValueError: If Lightning is not installed, or does not have the machine.
        OutputError: If the folder cannot be written, or holds a checkpoint and `resume` is off.
        WeightsError: If the checkpoint is damaged, or of a training with other options or frames.
    """
    require_lightning()
    from lightning.fabric.utilities.exceptions import MisconfigurationException
    from lightning.pytorch.utilities.exceptions import SIGTERMException

    from laploop.perception.training.stage_module import EpochWriter, StageModule

    where = machine or Machine()
    checkpoint = out / CHECKPOINT_NAME
    check_fresh(checkpoint, resume=resume)
    described = _identity(recipe, train, val)
    if checkpoint.exists() and not _unfinished(recipe, checkpoint, described):
        return out / f"{recipe.name}.safetensors"
    with _quiet(), torch.random.fork_rng(devices=[]):
        try:
            trainer = _trainer(recipe, out, where, EpochWriter(recipe, out, progress=progress))
        except (MisconfigurationException, ValueError, RuntimeError) as error:
            reason = " ".join(str(error).split())
            raise InvalidValueError("machine", to_plain(where), f"what Lightning has here: {reason}") from error
        starting()
        try:
            out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"cannot write to {out}: {error}") from error
        module = StageModule(recipe, train, val, identity=described, workers=where.workers, processes=where.processes)
        try:
            trainer.fit(module, ckpt_path=checkpoint if checkpoint.exists() else None)
        except SIGTERMException as error:
            raise KeyboardInterrupt from error
        if trainer.interrupted:
            raise KeyboardInterrupt
    return out / f"{recipe.name}.safetensors"


def check_fresh(checkpoint: Path, *, resume: bool) -> None:
    """Raise an `OutputError` if there is a checkpoint that would be overwritten, and `resume` is off."""
    if checkpoint.exists() and not resume:
        raise OutputError(f"{checkpoint} exists; go on from it with --resume, or choose another folder")


def _identity(recipe: Recipe, train: Samples, val: Samples) -> dict[str, object]:
    """Return all that decides the result of a training but its length, as plain data: a checkpoint is resumed by no other."""
    schedule = to_plain(recipe.schedule)
    del schedule["epochs"]
    return {
        "architecture": dict(recipe.architecture),
        **schedule,
        **recipe.settings,
        "content of the training frames": train.fingerprint,
        "content of the validation frames": val.fingerprint,
        "hash of the architecture": architecture_hash(recipe.architecture, recipe.network.state_dict()),
    }


def _unfinished(recipe: Recipe, checkpoint: Path, described: dict[str, object]) -> bool:
    """Return whether there are epochs left to do, after a check that the checkpoint is of the training described."""
    from laploop.perception.training.checkpoint_io import SafetensorsCheckpointIO

    content = SafetensorsCheckpointIO().load_checkpoint(checkpoint)
    changed = difference(content.get("identity"), described)
    if changed:
        raise WeightsError(f"{checkpoint} is of another training: its {changed}; resume with its own options and data")
    epoch = content.get("epoch")
    if not isinstance(epoch, int):
        raise WeightsError(f"the epoch of {checkpoint} is {epoch!r}; allowed: an integer")
    # Lightning counts from 0 and saves before it counts on.
    return epoch + 1 < recipe.schedule.epochs


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
