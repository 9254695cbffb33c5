"""A recipe as Lightning sees it, and what is written after every epoch."""

import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import lightning.pytorch as pl
import numpy as np
import torch
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from torch import Tensor
from torch.utils.data import DataLoader

from laploop.perception.training.epoch_log import LOG_NAME, read_rows, write_rows
from laploop.perception.training.fit import CHECKPOINT_NAME
from laploop.perception.training.muon import Muon
from laploop.perception.training.recipe import Batch, Recipe
from laploop.perception.training.samples import Samples, loader
from laploop.perception.weights import save_weights


class StageModule(pl.LightningModule):
    """Runs a recipe's loss, sets the learning rate, and measures the error in millimetres."""

    def __init__(
        self,
        recipe: Recipe,
        train: Samples,
        val: Samples,
        *,
        identity: Mapping[str, object],
        workers: int,
        processes: int,
    ) -> None:
        """Wrap a recipe and its frames; `identity` goes into checkpoints."""
        super().__init__()
        self.recipe = recipe
        self.network = recipe.network
        self._train, self._val, self._workers = train, val, workers
        self._identity = dict(identity)
        self._batches = math.ceil(math.ceil(len(train) / processes) / recipe.schedule.batch)
        self.totals: dict[str, list[float]] = {}
        self.val_sums = torch.zeros(4, dtype=torch.float64)
        self.rate = 0.0

    def train_dataloader(self) -> DataLoader[Any]:
        """Return this process's part of the training frames."""
        return self._loader(self._train, training=True)

    def val_dataloader(self) -> DataLoader[Any]:
        """Return this process's part of the validation frames."""
        return self._loader(self._val, training=False)

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Keep what the checkpoint is of, so that no other training resumes it."""
        checkpoint["identity"] = self._identity

    def configure_optimizers(self) -> torch.optim.Optimizer:
        """Return the schedule's optimiser; `adam` is AdamW where weights decay."""
        schedule = self.recipe.schedule
        if schedule.optimizer == "muon":
            apart = {parameter for layer in self.recipe.adam_layers() for parameter in layer.parameters()}
            learned = list(self.recipe.parameters())
            kernels = [parameter for parameter in learned if parameter.ndim >= 2 and parameter not in apart]
            others = [parameter for parameter in learned if parameter.ndim < 2 or parameter in apart]
            rate, decay = schedule.learning_rate, schedule.weight_decay
            return Muon(kernels, others, lr=rate, betas=schedule.betas, weight_decay=decay)
        kind = torch.optim.AdamW if schedule.weight_decay else torch.optim.Adam
        return kind(
            self.recipe.parameters(),
            lr=schedule.learning_rate,
            betas=schedule.betas,
            weight_decay=schedule.weight_decay,
        )

    def on_train_epoch_start(self) -> None:
        """Forget the last epoch's sums."""
        self.totals = {}

    def on_train_batch_start(self, batch: Batch, batch_idx: int) -> None:  # noqa: ARG002 - Lightning's signature
        """Set the learning rate and torch's generator; both depend on the count of batches, so there is no state to lose."""
        origin = [self.recipe.schedule.seed, self.current_epoch, batch_idx, self.global_rank]
        torch.manual_seed(int(np.random.default_rng(origin).integers(2**31)))
        self.rate = self.recipe.schedule.rate(self.current_epoch * self._batches + batch_idx, self._batches)
        for optimizer in self.trainer.optimizers:
            for group in optimizer.param_groups:
                group["lr"] = self.rate

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        """Return the loss of a batch."""
        done = (self.current_epoch + batch_idx / self._batches) / self.recipe.schedule.epochs
        loss = self.recipe.loss(batch, done)
        for name, part in {"loss": loss.total, **loss.parts}.items():
            value = part.detach()
            self.totals.setdefault(name, []).append(float(value))
            self.log(f"train/{name}", value, batch_size=len(batch["image"]))
        return loss.total

    def on_validation_epoch_start(self) -> None:
        """Forget the last epoch's sums."""
        self.val_sums = torch.zeros(4, dtype=torch.float64)

    def validation_step(self, batch: Batch, batch_idx: int) -> None:  # noqa: ARG002 - Lightning's signature
        """Add up the errors over all pixels with a truth, and over the valid ones of them."""
        prediction = self.recipe.predict(batch)
        truth = self.recipe.truth_mm(batch)
        known = torch.isfinite(truth)
        error = (prediction.depth_mm.float() - torch.where(known, truth, 0.0)).abs()
        sums = [(error[mask].double().sum(), mask.sum().double()) for mask in (known, known & prediction.valid)]
        self.val_sums += torch.stack([value for pair in sums for value in pair]).cpu()

    def _loader(self, samples: Samples, *, training: bool) -> DataLoader[Any]:
        # `current_epoch` is still one behind when a resumed training asks for its first batches.
        epochs: Any = self.trainer.fit_loop.epoch_progress.current
        return loader(
            samples,
            self.recipe,
            training=training,
            epoch=epochs.processed,
            workers=self._workers,
            rank=self.trainer.global_rank,
            processes=self.trainer.world_size,
        )

    def epoch_row(self) -> dict[str, float]:
        """Return one line of the log; every process must call it."""
        sums = self.val_sums
        if self.trainer.world_size > 1:
            gathered: Any = self.all_gather(sums.to(self.device, torch.float32))
            sums = gathered.reshape(-1, 4).sum(dim=0).double().cpu()
        row = {"epoch": self.current_epoch + 1.0, "learning_rate": self.rate}
        row |= {f"train_{name}": float(np.mean(values)) for name, values in self.totals.items()}
        row["val_mae_mm"] = float(sums[0] / sums[1].clamp(min=1))
        row["val_valid_mae_mm"] = float(sums[2] / sums[3].clamp(min=1))
        row["val_valid_share"] = float(sums[3] / sums[1].clamp(min=1))
        return row


class EpochWriter(pl.Callback):
    """After every epoch: weights, log, and last the checkpoint, each written atomically; a bar in between."""

    def __init__(self, recipe: Recipe, out: Path, *, progress: bool) -> None:
        self._recipe, self._out = recipe, out
        self._began = time.perf_counter()
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            TaskProgressColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
        )
        self._bar = Progress(*columns, console=Console(stderr=True), disable=not progress)
        self._task = self._bar.add_task(recipe.name, total=None)

    def on_train_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:  # noqa: ARG002 - Lightning's
        """Start the bar where the training starts, and drop log lines of epochs that will be run again."""
        if trainer.is_global_zero:
            write_rows(self._out / LOG_NAME, list(read_rows(self._out / LOG_NAME))[: trainer.current_epoch])
            self._bar.update(self._task, total=self._batches(trainer), completed=self._done(trainer, 0))
            self._bar.start()

    def on_train_epoch_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:  # noqa: ARG002
        """Take the time."""
        self._began = time.perf_counter()

    def on_train_batch_end(
        self,
        trainer: pl.Trainer,
        pl_module: pl.LightningModule,  # noqa: ARG002 - Lightning's signature
        outputs: Any,  # noqa: ARG002
        batch: Any,  # noqa: ARG002
        batch_idx: int,
    ) -> None:
        """Move the bar."""
        self._bar.update(self._task, completed=self._done(trainer, batch_idx + 1))

    def on_train_epoch_end(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Write everything."""
        if not isinstance(pl_module, StageModule):
            return
        row = pl_module.epoch_row()
        row["wall_s"] = time.perf_counter() - self._began
        if trainer.is_global_zero:
            path = self._out / f"{self._recipe.name}.safetensors"
            notes = {"epoch": str(int(row["epoch"])), "val_mae_mm": f"{row['val_mae_mm']:.4f}"}
            save_weights(path, self._recipe.network.state_dict(), self._recipe.architecture, notes)
            write_rows(self._out / LOG_NAME, [*read_rows(self._out / LOG_NAME), row])
            text = f"{self._recipe.name} {int(row['epoch'])}: {row['val_mae_mm']:.2f} {self._recipe.error_unit}"
            self._bar.update(self._task, description=text)
            for logger in trainer.loggers:
                logger.log_metrics({f"epoch/{name}": value for name, value in row.items()}, step=trainer.current_epoch)
        trainer.save_checkpoint(self._out / CHECKPOINT_NAME, weights_only=False)

    def teardown(self, trainer: pl.Trainer, pl_module: pl.LightningModule, stage: str) -> None:  # noqa: ARG002
        """Take the bar away, also after an interrupt."""
        self._bar.stop()

    def _batches(self, trainer: pl.Trainer) -> int:
        return int(trainer.num_training_batches) * self._recipe.schedule.epochs

    def _done(self, trainer: pl.Trainer, batches: int) -> int:
        return trainer.current_epoch * int(trainer.num_training_batches) + batches
