"""Training of the compact network: one plain loop on the CPU that can be stopped and resumed at any epoch."""

import csv
import io
import math
import os
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import Progress, track
from torch import Tensor

from laploop.errors import InvalidValueError, OutputError
from laploop.perception.data.frame_store import FrameStore
from laploop.perception.geometry import Rig
from laploop.perception.metrics import DepthErrors
from laploop.perception.networks.compact_unet import CompactConfig, CompactOutput, CompactUNet
from laploop.perception.weights import load_weights, save_weights

WEIGHTS_NAME = "compact.safetensors"
CHECKPOINT_NAME = "checkpoint.safetensors"
LOG_NAME = "log.csv"
_NEAREST_MM, _FARTHEST_MM = 20.0, 250.0
"""Truth outside is not learned from: the network's turns end about there."""


@dataclass(frozen=True, kw_only=True)
class CompactTraining:
    """The schedule."""

    epochs: int = 36
    """May be changed on resume: the learning rate follows the share of the epochs that is done."""
    batch: int = 8
    learning_rate: float = 2e-3
    """At the start of the cosine, which ends at a hundredth of it."""
    warmup_steps: int = 200
    weight_decay: float = 1e-4
    l1_weight: float = 0.3
    """Weight of the absolute error in millimetres beside the Laplace likelihood, which cares little for the worst pixels."""
    gain_range: float = 0.15
    """Images are made brighter or darker by up to this share."""
    bfloat16: bool = True
    """Convolutions in bfloat16; halves the time of a step where the processor has instructions for it."""
    seed: int = 0

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a field lies outside its range.
        """
        for name in ("epochs", "batch", "learning_rate"):
            if not getattr(self, name) > 0:
                raise InvalidValueError(name, getattr(self, name), "above 0")
        for name in ("warmup_steps", "weight_decay", "l1_weight"):
            if getattr(self, name) < 0:
                raise InvalidValueError(name, getattr(self, name), "0 or more")
        if not 0.0 <= self.gain_range < 1.0:
            raise InvalidValueError("gain_range", self.gain_range, "0 to below 1")


@dataclass(frozen=True, kw_only=True)
class EpochRecord:
    """One line of the log."""

    epoch: int
    learning_rate: float
    train_loss: float
    train_mae_mm: float
    val_mae_mm: float
    val_valid_mae_mm: float
    val_valid_share: float
    wall_s: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Frames:
    """Images and depths of one split in memory, each (n, height, width)."""

    image: NDArray[np.uint8]
    depth_mm: NDArray[np.float32]

    @classmethod
    def read(cls, store: FrameStore, split: str, *, progress: bool = False) -> "Frames":
        """Read the frames of a split that are done."""
        chosen = store.indices(split)
        size = (len(chosen), store.optics.height, store.optics.width)
        image, depth_mm = np.empty(size, np.uint8), np.empty(size, np.float32)
        for row, index in enumerate(track(chosen, f"reading {split}", console=Console(stderr=True), disable=not progress)):
            image[row], depth_mm[row] = store.image(int(index)), store.depth_mm(int(index))
        return cls(image=image, depth_mm=depth_mm)


def laplace_loss(output: CompactOutput, truth_mm: Tensor, l1_weight: float) -> tuple[Tensor, Tensor]:
    """Return the loss and the mean absolute error in millimetres over the pixels with usable truth.

    The loss is the negative log-likelihood of a Laplace distribution, |error| / scale + ln(scale), plus the absolute error.
    """
    known = (truth_mm >= _NEAREST_MM) & (truth_mm <= _FARTHEST_MM)
    error = (output.depth_mm - torch.where(known, truth_mm, 100.0)).abs()
    loss = error * (torch.exp(-output.log_scale) + l1_weight) + output.log_scale
    weight = known.to(loss.dtype) / known.sum().clamp(min=1)
    return (loss * weight).sum(), (error * weight).sum()


def train_compact(
    dataset: Path,
    out: Path,
    *,
    training: CompactTraining | None = None,
    network: CompactConfig | None = None,
    resume: bool = False,
    progress: bool = True,
) -> Path:
    """Train on the store `dataset` and return the path of the weights in the folder `out`.

    After every epoch the folder holds the newest weights, a checkpoint to resume from, and the log. With `resume`, training
    goes on from the checkpoint, if there is one, as if it had never stopped.

    Raises:
        OutputError: If `out` cannot be written, or holds a checkpoint and `resume` is off.
    """
    settings = training or CompactTraining()
    store = FrameStore.open(dataset)
    trainer = CompactTrainer(Rig.from_optics(store.optics), network or CompactConfig(), settings)
    checkpoint = out / CHECKPOINT_NAME
    rows: list[EpochRecord] = []
    if checkpoint.exists():
        if not resume:
            raise OutputError(f"{checkpoint} exists; pass resume to go on from it, or give another folder")
        trainer.load_checkpoint(checkpoint)
        rows = _read_log(out / LOG_NAME)[: trainer.epoch]
    train = Frames.read(store, "train", progress=progress)
    val = Frames.read(store, "val", progress=progress)
    with Progress(console=Console(stderr=True), disable=not progress) as bar:
        task = bar.add_task("training", total=settings.epochs, completed=trainer.epoch)
        while trainer.epoch < settings.epochs:
            record = trainer.run_epoch(train, val)
            rows.append(record)
            trainer.save(out, checkpoint)
            _write_log(out / LOG_NAME, rows)
            text = f"epoch {record.epoch}: {record.val_valid_mae_mm:.2f} mm on {record.val_valid_share:.0%}"
            bar.update(task, advance=1, description=text)
    return out / WEIGHTS_NAME


class CompactTrainer:
    """The network, its optimiser, and how many epochs they have seen."""

    def __init__(self, rig: Rig, network: CompactConfig, settings: CompactTraining) -> None:
        """Start from random weights that depend on the seed alone."""
        self.settings = settings
        self.epoch = 0
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(settings.seed)
            self.network = CompactUNet(rig, network)
        self.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.optimizer = torch.optim.AdamW(
            self.network.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay
        )

    def learning_rate(self, step: int, steps: int) -> float:
        """Return the rate at a step: a linear start, then a cosine down to a hundredth at the last of `steps`."""
        start = min(1.0, (step + 1) / (self.settings.warmup_steps + 1))
        cosine = 0.5 * (1.0 + math.cos(math.pi * min(1.0, step / max(1, steps))))
        return self.settings.learning_rate * start * (0.01 + 0.99 * cosine)

    def run_epoch(self, train: Frames, val: Frames) -> EpochRecord:
        """Go once through the training frames in an order that depends on seed and epoch alone, then validate."""
        began = time.perf_counter()
        self.network.train()
        batches = math.ceil(len(train.image) / self.settings.batch)
        totals = np.zeros(2)
        rate = 0.0
        for index, (image, truth) in enumerate(self._batches(train)):
            rate = self.learning_rate(self.epoch * batches + index, self.settings.epochs * batches)
            for group in self.optimizer.param_groups:
                group["lr"] = rate
            with torch.autocast("cpu", dtype=torch.bfloat16, enabled=self.settings.bfloat16):
                output = self.network(image)
            loss, error = laplace_loss(output, truth, self.settings.l1_weight)
            self.optimizer.zero_grad(set_to_none=True)
            loss.backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(self.network.parameters(), 5.0)
            self.optimizer.step()
            totals += [loss.item(), error.item()]
        self.epoch += 1
        overall, valid, share = self.validate(val)
        return EpochRecord(
            epoch=self.epoch,
            learning_rate=rate,
            train_loss=totals[0] / batches,
            train_mae_mm=totals[1] / batches,
            val_mae_mm=overall,
            val_valid_mae_mm=valid,
            val_valid_share=share,
            wall_s=time.perf_counter() - began,
        )

    def validate(self, frames: Frames, max_scale_mm: float = 2.0) -> tuple[float, float, float]:
        """Return the error in mm at 60-140 mm over all pixels and over the valid ones, and the share of those."""
        self.network.eval()
        overall, valid = DepthErrors(), DepthErrors()
        with torch.inference_mode():
            for start in range(0, len(frames.image), self.settings.batch):
                rows = slice(start, start + self.settings.batch)
                output = self.network(torch.from_numpy(frames.image[rows].astype(np.float32)))
                truth = frames.depth_mm[rows]
                known = (truth >= 60.0) & (truth <= 140.0)
                depth_mm = output.depth_mm.numpy()
                overall.add(depth_mm, truth, known)
                valid.add(depth_mm, truth, known & (output.log_scale.numpy() <= math.log(max_scale_mm)))
        share = valid.metrics().pixels / max(1, overall.metrics().pixels)
        return overall.metrics().mae_mm, valid.metrics().mae_mm, share

    def save(self, out: Path, checkpoint: Path) -> None:
        """Write the weights, and after them the checkpoint."""
        architecture = self.network.config.architecture
        save_weights(out / WEIGHTS_NAME, self.network.state_dict(), architecture, {"epoch": str(self.epoch)})
        notes = {"epoch": str(self.epoch), "training": str(asdict(self.settings))}
        save_weights(checkpoint, self._checkpoint_tensors(), {"checkpoint": architecture}, notes)

    def load_checkpoint(self, path: Path) -> None:
        """Take over a checkpoint's network, optimiser and epoch.

        Raises:
            WeightsError: If it is damaged or of another architecture.
        """
        # The optimiser has no state before its first step; the layout of one is needed to check the file against.
        for parameter in self.network.parameters():
            self.optimizer.state[parameter] = {
                "step": torch.tensor(0.0),
                "exp_avg": torch.zeros_like(parameter, memory_format=torch.preserve_format),
                "exp_avg_sq": torch.zeros_like(parameter, memory_format=torch.preserve_format),
            }
        architecture = {"checkpoint": self.network.config.architecture}
        current = self._checkpoint_tensors()
        tensors, notes = load_weights(path, architecture, current)
        with torch.no_grad():
            for name, tensor in current.items():
                tensor.copy_(tensors[name])
        self.epoch = int(notes["epoch"])

    def _checkpoint_tensors(self) -> dict[str, Tensor]:
        tensors = {f"network.{name}": tensor for name, tensor in self.network.state_dict().items()}
        for name, parameter in self.network.named_parameters():
            for key, value in self.optimizer.state[parameter].items():
                tensors[f"optimizer.{name}.{key}"] = value
        return tensors

    def _batches(self, frames: Frames) -> Iterator[tuple[Tensor, Tensor]]:
        """Yield shuffled, augmented batches; a rig mirrored top to bottom is the same rig."""
        rng = np.random.default_rng([self.settings.seed, self.epoch])
        order = rng.permutation(len(frames.image))
        for start in range(0, len(order), self.settings.batch):
            rows = order[start : start + self.settings.batch]
            image, truth = frames.image[rows].astype(np.float32), frames.depth_mm[rows]
            flipped = rng.random(len(rows)) < 0.5
            image[flipped], truth[flipped] = image[flipped, ::-1], truth[flipped, ::-1]
            gain = 1.0 + self.settings.gain_range * rng.uniform(-1.0, 1.0, (len(rows), 1, 1))
            image = np.minimum(np.round(image * gain), 255.0).astype(np.float32)
            yield torch.from_numpy(image), torch.from_numpy(truth)


def _write_log(path: Path, rows: list[EpochRecord]) -> None:
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(EpochRecord.__dataclass_fields__))
    writer.writeheader()
    writer.writerows(asdict(row) for row in rows)
    partial = path.with_name(f"{path.name}.{os.getpid()}.partial")
    partial.write_text(text.getvalue())
    partial.replace(path)


def _read_log(path: Path) -> list[EpochRecord]:
    if not path.is_file():
        return []
    with path.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    return [EpochRecord(epoch=int(row.pop("epoch")), **{name: float(value) for name, value in row.items()}) for row in rows]
