"""Training of `ssle-phase` in two stages: the reader from the image, then the refiner around its reading.

Both learn from likelihood and absolute error in millimetres, through the triangulation.
"""

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from laploop.configuration import to_plain
from laploop.perception.data.datasets import DepthDataset
from laploop.perception.networks.configs import SslePhaseConfig
from laploop.perception.networks.depth_network import PhaseOutput
from laploop.perception.networks.ssle_phase import SslePhase, triangulate, triangulated
from laploop.perception.networks.ssle_phase_front import PhaseFilters, RigBatch, rig_numbers
from laploop.perception.networks.ssle_phase_reader import PhaseReading
from laploop.perception.training.recipe import Batch, Loss, Prediction, Sample, seeded
from laploop.perception.training.run import TrainingRun
from laploop.perception.training.scale_recipe import ScaleRecipe
from laploop.perception.training.settings import SslePhaseTraining
from laploop.perception.weights import load_weights

_NEAREST_MM, _FARTHEST_MM = 20.0, 250.0
"""The network's depth ends about there. From truth outside, only the likelihood learns: that the depth is unknown."""

TRAINED = "trained"
"""Where the first stage comes from, if not from a file."""


class _PhaseRecipe(ScaleRecipe):
    """What both stages share; every sample brings its rig."""

    def __init__(self, phase: SslePhase, training: SslePhaseTraining, first_stage: str) -> None:
        """Train a part of a network whose first stage comes from `first_stage`, in words."""
        self.phase, self.config, self.training = phase, phase.config, training
        self.gain_range, self.max_scale_mm = training.gain_range, training.max_scale_mm
        plain = to_plain(training)
        # Those of the last stage may be changed on resume.
        del plain["refiner"]["epochs"]
        self.settings = {**plain, "first stage": first_stage}

    def extras(self, dataset: DepthDataset, index: int) -> Sample:
        """Return the numbers of the frame's rig."""
        return {"rig": np.array(rig_numbers(dataset.rig(index)))}


class ReaderRecipe(_PhaseRecipe):
    """The first stage."""

    name = "reader"

    def __init__(self, config: SslePhaseConfig, training: SslePhaseTraining) -> None:
        super().__init__(seeded(lambda: SslePhase(config), training.reader.seed), training, TRAINED)
        self.schedule = training.reader
        self.network = self.phase.reader

    @property
    def architecture(self) -> Mapping[str, object]:
        """The whole network's, and which part this is."""
        return {**self.config.architecture, "format": f"{self.config.form}-{self.name}"}

    def adam_layers(self) -> Iterable[nn.Module]:
        """Return the output layers."""
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

    def __init__(self, phase: SslePhase, training: SslePhaseTraining, first_stage: str = TRAINED) -> None:
        super().__init__(phase, training, first_stage)
        self.schedule = training.refiner
        self.variants = training.variants
        self.network = self.phase
        self.phase.reader.requires_grad_(requires_grad=False)
        for module in self.phase.refiner.modules():
            if isinstance(module, nn.BatchNorm2d):
                module.momentum = training.norm_momentum

    def adam_layers(self) -> Iterable[nn.Module]:
        """Return the output layer."""
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

    def _run(self, batch: Batch) -> PhaseOutput:
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


def ssle_phase_loss(output: PhaseOutput, truth_mm: Tensor, training: SslePhaseTraining) -> Loss:
    """Return the loss over the pixels with truth.

    The negative log-likelihood of a Laplace distribution, |error| / scale + ln(scale), plus the absolute error where the
    network can express such a depth. An instrument right before the camera is nearer than that: it must at least not pass for
    tissue.
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
    run: TrainingRun,
    *,
    config: SslePhaseConfig,
    training: SslePhaseTraining,
    reader: Path | None = None,
    start: Path | None = None,
) -> Path:
    """Train both stages and return the path of the weights; the reader has the folder `reader`.

    With the weights of a trained `reader`, it is not trained again. With those of a whole network to `start` from, its reader
    stays as it is and its refiner learns on.

    Raises:
        MissingFileError: If there are no weights at a given path.
        WeightsError: If they are damaged or of another network.
    """
    first = ReaderRecipe(config, training)
    given, origin = start or reader, TRAINED
    if given is not None:
        whole = start is not None
        recipe = SslePhaseRecipe(first.phase, training) if whole else first
        recipe.network.load_state_dict(load_weights(given, recipe.architecture, recipe.network.state_dict())[0])
        origin = f"{'start' if whole else 'reader'} {hashlib.sha256(given.read_bytes()).hexdigest()[:16]}"
    frames = run.read(first)
    if given is None:
        run.fit(first, frames, first.name)
    return run.fit(SslePhaseRecipe(first.phase, training, origin), frames)
