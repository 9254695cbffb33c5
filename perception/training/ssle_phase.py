"""Training of `ssle-phase` in two stages: the reader from the image, then the refiner around what the reader says.

Both learn from likelihood and absolute error in millimetres, through the triangulation.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from laploop.errors import InvalidValueError
from laploop.perception.data.datasets import DepthDataset
from laploop.perception.networks.ssle_phase import (
    FORMAT,
    SslePhase,
    SslePhaseConfig,
    SslePhaseOutput,
    triangulate,
    triangulated,
)
from laploop.perception.networks.ssle_phase_front import PhaseFilters, RigBatch, rig_numbers
from laploop.perception.networks.ssle_phase_reader import PhaseReading
from laploop.perception.training.fit import Machine, check_fresh, fit, require_lightning
from laploop.perception.training.recipe import Batch, Loss, Prediction, Recipe, Sample, Schedule, flip_and_gain, seeded
from laploop.perception.training.samples import Samples, check_against, check_size
from laploop.perception.weights import load_weights

_NEAREST_MM, _FARTHEST_MM = 20.0, 250.0
"""The network's depth ends about there. Of truth outside only the likelihood learns, which is to say that nobody knows."""


def _schedule(epochs: int) -> Schedule:
    return Schedule(
        epochs=epochs,
        batch=8,
        learning_rate=2e-3,
        final_learning_rate=1e-5,
        per_step=True,
        warmup_steps=200,
        optimizer="muon",
        weight_decay=1e-4,
        clip_norm=5.0,
        bfloat16=True,
    )


@dataclass(frozen=True, kw_only=True)
class SslePhaseTraining:
    """The schedules, and what the losses weigh."""

    reader: Schedule = field(default_factory=lambda: _schedule(epochs=12))
    refiner: Schedule = field(default_factory=lambda: _schedule(epochs=12))
    l1_weight: float = 0.5
    """Weight of the absolute error in millimetres beside the Laplace likelihood, which cares little for the worst pixels;
    that of the depth before the reader's second demodulation too."""
    coarse_weight: float = 10.0
    """Weight of the coarse depth's error, the difference of logarithms: this is what picks the stripe order."""
    gain_range: float = 0.15
    """Images are made brighter or darker by up to this share."""
    variants: int = 2
    """Of a frame, mirrored or not, each with its gain; the refiner's training keeps their readings in memory, 0.4 MB each."""
    norm_momentum: float = 0.02
    """Share of a batch in the running statistics of the refiner's normalisation. With torch's own, 0.1, they are those of the
    last ten batches, by whose chance the error of validation varied by a twentieth."""
    max_scale_mm: float = 2.0
    """In validation, a pixel is valid where its predicted scale is at most this."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a field lies outside its range.
        """
        for name in ("l1_weight", "coarse_weight"):
            if not getattr(self, name) >= 0.0:
                raise InvalidValueError(name, getattr(self, name), "0 or more")
        if not 0.0 <= self.gain_range < 1.0:
            raise InvalidValueError("gain_range", self.gain_range, "0 to below 1")
        if self.variants < 1:
            raise InvalidValueError("variants", self.variants, "1 or more")
        if not 0.0 < self.norm_momentum <= 1.0:
            raise InvalidValueError("norm_momentum", self.norm_momentum, "above 0 and at most 1")
        if not self.max_scale_mm > 0.0:
            raise InvalidValueError("max_scale_mm", self.max_scale_mm, "above 0 mm")


class _PhaseRecipe(Recipe):
    """What both stages share; every sample brings its rig."""

    def __init__(self, phase: SslePhase, training: SslePhaseTraining) -> None:
        """Train a part of a network."""
        self.phase = phase
        self.training = training

    def extras(self, dataset: DepthDataset, index: int) -> Sample:
        """Return the numbers of the frame's rig."""
        return {"rig": np.array(rig_numbers(dataset.rig(index)))}

    def augment(self, sample: Sample, rng: np.random.Generator) -> Sample:
        """Mirror top to bottom, for which a rig with a centred camera stays the same, and change the gain."""
        return flip_and_gain(sample, rng, self.training.gain_range)

    def truth_mm(self, batch: Batch) -> Tensor:
        """Return the truth at 60 to 140 mm, where the loop works."""
        truth = batch["depth_mm"]
        return torch.where((truth >= 60.0) & (truth <= 140.0), truth, torch.nan)

    def prediction(self, output: SslePhaseOutput) -> Prediction:
        """Return the depth, valid where the network expects it to be near enough."""
        return Prediction(depth_mm=output.depth_mm, valid=output.log_scale <= math.log(self.training.max_scale_mm))


class ReaderRecipe(_PhaseRecipe):
    """The first stage."""

    name = "reader"

    def __init__(self, config: SslePhaseConfig, training: SslePhaseTraining) -> None:
        """Make the network with random weights that depend on the seed alone."""
        super().__init__(seeded(lambda: SslePhase(config), training.reader.seed), training)
        self.schedule = training.reader
        self.network = self.phase.reader

    @property
    def architecture(self) -> Mapping[str, object]:
        """The whole network's, and which part this is."""
        return {**self.phase.config.architecture, "format": f"{FORMAT}-{self.name}"}

    def adam_layers(self) -> Iterable[nn.Module]:
        """Return the layers that say the results."""
        return (self.phase.reader.head, self.phase.reader.fine_head)

    def loss(self, batch: Batch, progress: float) -> Loss:  # noqa: ARG002 - the weights do not change
        """Return `reader_loss`."""
        reading, metre = self._run(batch)
        return reader_loss(reading, metre, batch["depth_mm"], self.training)

    def predict(self, batch: Batch) -> Prediction:
        """Return the depth of the reading."""
        reading, metre = self._run(batch)
        return self.prediction(triangulated(reading.turns, reading.log_scale, metre))

    def _run(self, batch: Batch) -> tuple[PhaseReading, Tensor]:
        image = batch["image"]
        # The front end belongs to the whole network, which the harness does not move.
        phase = self.phase.to(image.device)
        filters = phase.prepare(rigs_of(batch))
        with self.autocast(image.device):
            reading: PhaseReading = phase.reader(phase.see(image, filters), phase.front, filters)
        return reading, filters.turns_metre


class SslePhaseRecipe(_PhaseRecipe):
    """The second stage, which leaves the reader as it is; what it saves is the whole network."""

    name = "ssle-phase"

    def __init__(self, phase: SslePhase, training: SslePhaseTraining) -> None:
        """Take over a network with a trained reader."""
        super().__init__(phase, training)
        self.schedule = training.refiner
        self.variants = training.variants
        self.network = self.phase
        self.phase.reader.requires_grad_(requires_grad=False)
        for module in self.phase.refiner.modules():
            if isinstance(module, nn.BatchNorm2d):
                module.momentum = training.norm_momentum

    @property
    def architecture(self) -> Mapping[str, object]:
        """The network's."""
        return self.phase.config.architecture

    def adam_layers(self) -> Iterable[nn.Module]:
        """Return the layer that says the results."""
        return (self.phase.refiner.head,)

    def loss(self, batch: Batch, progress: float) -> Loss:  # noqa: ARG002 - the weights do not change
        """Return `ssle_phase_loss`."""
        return ssle_phase_loss(self._run(batch), batch["depth_mm"], self.training)

    def predict(self, batch: Batch) -> Prediction:
        """Return the depth."""
        return self.prediction(self._run(batch))

    def derive(self, sample: Sample) -> Sample:
        """Return the reading of a frame.

        The reader runs in evaluation mode, in single precision and on one frame at a time, so that the reading is the same
        whatever else is in a batch.
        """
        device = next(self.phase.parameters()).device
        image = torch.from_numpy(np.ascontiguousarray(sample["image"]))[None].to(device, torch.float32)
        filters = self.phase.prepare(RigBatch(values=torch.from_numpy(sample["rig"])[None].to(device)))
        reading = self._read(image, filters)
        return {"turns": reading.turns[0].cpu().numpy(), "log_scale": reading.log_scale[0].half().cpu().numpy()}

    def _read(self, image: Tensor, filters: PhaseFilters) -> PhaseReading:
        self.phase.reader.eval()
        with torch.no_grad():
            reading: PhaseReading = self.phase.reader(self.phase.see(image, filters), self.phase.front, filters)
        return reading

    def _run(self, batch: Batch) -> SslePhaseOutput:
        image = batch["image"]
        filters = self.phase.prepare(rigs_of(batch))
        if "turns" in batch:
            turns, log_scale = batch["turns"], batch["log_scale"].float()
        else:
            reading = self._read(image, filters)
            turns, log_scale = reading.turns, reading.log_scale
        with self.autocast(image.device):
            return self.phase.refine(self.phase.see(image, filters), turns, log_scale, filters)


def rigs_of(batch: Batch) -> RigBatch:
    """Return the rigs of a batch."""
    return RigBatch(values=batch["rig"].to(torch.float64))


def ssle_phase_loss(output: SslePhaseOutput, truth_mm: Tensor, training: SslePhaseTraining) -> Loss:
    """Return the loss over the pixels with truth.

    The negative log-likelihood of a Laplace distribution, |error| / scale + ln(scale), plus, where the network can tell such a
    depth, the absolute error. An instrument right before the camera is nearer than that: it must at least not pass for tissue.
    """
    known = torch.isfinite(truth_mm)
    error = (output.depth_mm - torch.where(known, truth_mm, 100.0)).abs()
    likelihood = error * torch.exp(-output.log_scale) + output.log_scale
    absolute = (error * _usable(truth_mm)[1]).sum()
    total = (likelihood * _weights(known)).sum() + training.l1_weight * absolute
    return Loss(total=total, parts={"mae_mm": absolute})


def reader_loss(reading: PhaseReading, turns_metre: Tensor, truth_mm: Tensor, training: SslePhaseTraining) -> Loss:
    """Return the loss of a reading: `ssle_phase_loss`, plus the errors of what came before it.

    These are the absolute error of the depth before the second demodulation, and that of the logarithm of the coarse depth.
    """
    last = ssle_phase_loss(triangulated(reading.turns, reading.log_scale, turns_metre), truth_mm, training)
    truth, weight = _usable(truth_mm)
    first = ((1e3 * triangulate(reading.first_turns, turns_metre) - truth).abs() * weight).sum()
    coarse = ((torch.log(1e3 * triangulate(reading.coarse_turns, turns_metre)) - torch.log(truth)).abs() * weight).sum()
    return Loss(
        total=last.total + training.l1_weight * first + training.coarse_weight * coarse,
        parts={**last.parts, "first_mae_mm": first, "coarse_log_error": coarse},
    )


def _usable(truth_mm: Tensor) -> tuple[Tensor, Tensor]:
    """Return the truth with a number at every pixel, and the weights of those within reach, whose sum is 1 or 0."""
    known = (truth_mm >= _NEAREST_MM) & (truth_mm <= _FARTHEST_MM)
    return torch.where(known, truth_mm, 100.0), _weights(known)


def _weights(mask: Tensor) -> Tensor:
    return mask.to(torch.float32) / mask.sum().clamp(min=1)


def train_ssle_phase(
    dataset: DepthDataset,
    out: Path,
    *,
    config: SslePhaseConfig,
    training: SslePhaseTraining,
    reader: Path | None = None,
    start: Path | None = None,
    against: str = "exact",
    machine: Machine | None = None,
    limit: int | None = None,
    resume: bool = False,
    progress: bool = True,
) -> Path:
    """Train both stages and return the path of the weights in `out`; the reader has the folder `reader` in it.

    With `resume`, a reader that is done is taken as it is, and the stage that was interrupted goes on.

    Args:
        dataset: With a training and a validation split.
        out: Folder of weights, checkpoint and logs.
        config: Of the network.
        training: Schedules and losses.
        reader: Weights of a trained reader, which is then not trained again.
        start: Weights of a whole network to go on from: its reader stays as it is, its refiner learns on.
        against: `exact` or `zivid`, the depth to learn.
        machine: What to train on.
        limit: Largest number of frames of each split.
        resume: Go on from the checkpoint.
        progress: Show a bar.

    Raises:
        InvalidValueError: If the data set does not fit the network, Lightning is not installed, or both weights are given.
        OutputError: If `out` holds a training and `resume` is off.
        MissingFileError: If there are no weights where they are said to be.
        WeightsError: If they are damaged or of another network.
    """
    require_lightning()
    if reader is not None and start is not None:
        raise InvalidValueError("reader", reader, "none with start: a whole network has its reader")
    check_size(dataset, config.height, config.width)
    check_against(dataset, against)
    for folder in (out / ReaderRecipe.name, out):
        check_fresh(folder / "checkpoint.safetensors", resume=resume)
    first = ReaderRecipe(config, training)
    given = None if reader is None else load_weights(reader, first.architecture, first.network.state_dict())[0]
    if start is not None:
        first.phase.load_state_dict(load_weights(start, config.architecture, first.phase.state_dict())[0])
        given = first.network.state_dict()
    train = Samples.read(dataset, "train", first, against=against, limit=limit, progress=progress)
    val = Samples.read(dataset, "val", first, against=against, limit=limit, progress=progress)
    if given is None:
        path = fit(first, train, val, out / first.name, machine=machine, resume=resume, progress=progress)
        given, _ = load_weights(path, first.architecture, first.network.state_dict())
    first.network.load_state_dict(given)
    second = SslePhaseRecipe(first.phase, training)
    return fit(second, train, val, out, machine=machine, resume=resume, progress=progress)
