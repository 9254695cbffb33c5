"""Training of `ssle-phase`: likelihood and absolute error in millimetres, through the triangulation."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Unpack

import numpy as np
import torch
from torch import Tensor

from laploop.errors import InvalidValueError
from laploop.perception.datasets import DepthDataset
from laploop.perception.networks.ssle_phase import SslePhase, SslePhaseConfig, SslePhaseOutput
from laploop.perception.networks.ssle_phase_front import RigBatch, rig_numbers
from laploop.perception.training.recipe import Batch, Loss, Prediction, Recipe, Sample, Schedule, flip_and_gain, seeded
from laploop.perception.training.single_stage import TrainingOptions, train_single_stage

_NEAREST_MM, _FARTHEST_MM = 20.0, 250.0
"""Truth outside is not learned from: the network's depth ends about there."""


@dataclass(frozen=True, kw_only=True)
class SslePhaseTraining:
    """The schedule."""

    schedule: Schedule = field(
        default_factory=lambda: Schedule(
            epochs=12,
            batch=8,
            learning_rate=2e-3,
            final_learning_rate=1e-5,
            per_step=True,
            warmup_steps=200,
            weight_decay=1e-4,
            clip_norm=5.0,
            bfloat16=True,
        )
    )
    l1_weight: float = 0.3
    """Weight of the absolute error in millimetres beside the Laplace likelihood, which cares little for the worst pixels;
    that of the depth before the second stage too."""
    coarse_weight: float = 10.0
    """Weight of the coarse depth's error, the difference of logarithms: this is what picks the stripe order."""
    gain_range: float = 0.15
    """Images are made brighter or darker by up to this share."""
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
        if not self.max_scale_mm > 0.0:
            raise InvalidValueError("max_scale_mm", self.max_scale_mm, "above 0 mm")


class SslePhaseRecipe(Recipe):
    """The network with its loss; every sample brings its rig."""

    name = "ssle-phase"

    def __init__(self, config: SslePhaseConfig, training: SslePhaseTraining) -> None:
        """Make the network with random weights that depend on the seed alone."""
        self.schedule = training.schedule
        self._training = training
        self.phase = seeded(lambda: SslePhase(config), training.schedule.seed)
        self.phase.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.network = self.phase

    @property
    def architecture(self) -> Mapping[str, object]:
        """The network's."""
        return self.phase.config.architecture

    def extras(self, dataset: DepthDataset, index: int) -> Sample:
        """Return the numbers of the frame's rig."""
        return {"rig": np.array(rig_numbers(dataset.rig(index)))}

    def augment(self, sample: Sample, rng: np.random.Generator) -> Sample:
        """Mirror top to bottom, for which a rig with a centred camera stays the same, and change the gain."""
        return flip_and_gain(sample, rng, self._training.gain_range)

    def loss(self, batch: Batch, progress: float) -> Loss:  # noqa: ARG002 - the weights do not change
        """Return `ssle_phase_loss`."""
        return ssle_phase_loss(self._run(batch), batch["depth_mm"], self._training)

    def predict(self, batch: Batch) -> Prediction:
        """Return the depth, valid where the network expects it to be near enough."""
        output = self._run(batch)
        return Prediction(depth_mm=output.depth_mm, valid=output.log_scale <= math.log(self._training.max_scale_mm))

    def truth_mm(self, batch: Batch) -> Tensor:
        """Return the truth at 60 to 140 mm, where the loop works."""
        truth = batch["depth_mm"]
        return torch.where((truth >= 60.0) & (truth <= 140.0), truth, torch.nan)

    def _run(self, batch: Batch) -> SslePhaseOutput:
        image = batch["image"]
        with self.autocast(image.device):
            output: SslePhaseOutput = self.phase(image, RigBatch(values=batch["rig"].to(torch.float64)))
        return output


def ssle_phase_loss(output: SslePhaseOutput, truth_mm: Tensor, training: SslePhaseTraining) -> Loss:
    """Return the loss over the pixels with usable truth.

    The negative log-likelihood of a Laplace distribution, |error| / scale + ln(scale), plus the absolute errors of the final
    depth and of that before the second stage, plus that of the logarithm of the coarse depth.
    """
    known = (truth_mm >= _NEAREST_MM) & (truth_mm <= _FARTHEST_MM)
    truth = torch.where(known, truth_mm, 100.0)
    weight = known.to(torch.float32) / known.sum().clamp(min=1)
    error = (output.depth_mm - truth).abs()
    first = (output.first_mm - truth).abs()
    coarse = (torch.log(output.coarse_mm) - torch.log(truth)).abs()
    likelihood = error * torch.exp(-output.log_scale) + output.log_scale
    total = likelihood + training.l1_weight * (error + first) + training.coarse_weight * coarse
    return Loss(
        total=(total * weight).sum(),
        parts={
            "mae_mm": (error * weight).sum(),
            "first_mae_mm": (first * weight).sum(),
            "coarse_log_error": (coarse * weight).sum(),
        },
    )


def train_ssle_phase(
    dataset: DepthDataset,
    out: Path,
    *,
    config: SslePhaseConfig,
    training: SslePhaseTraining,
    **options: Unpack[TrainingOptions],
) -> Path:
    """Train and return the path of the weights in `out`; options and errors as for `train_single_stage`."""
    size = (config.height, config.width)
    return train_single_stage(dataset, out, lambda: SslePhaseRecipe(config, training), size=size, **options)
