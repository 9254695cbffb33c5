"""Training of the prior method, MaskNet times DepthNet."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Unpack

import numpy as np
import torch
from torch.nn import functional

from laploop.errors import InvalidValueError, UnknownNameError
from laploop.perception.data.datasets import DepthDataset
from laploop.perception.networks.dual_unet import DualUNet, DualUNetConfig
from laploop.perception.training.losses import masked_l1, masked_mean
from laploop.perception.training.recipe import Batch, Loss, Prediction, Recipe, Sample, Schedule, flip_and_gain, seeded
from laploop.perception.training.single_stage import TrainingOptions, train_single_stage


@dataclass(frozen=True, kw_only=True)
class DualUNetTraining:
    """The schedule; the publication is not open to us, so that the defaults are those of the newer method's U-Net."""

    schedule: Schedule = field(default_factory=lambda: Schedule(epochs=161, learning_rate=1e-3, final_learning_rate=1e-6))
    mask_weight: float = 0.1
    """Weight of MaskNet's cross-entropy beside DepthNet's errors, which are in units of the depth range."""
    square_weight: float = 1.0
    """Weight of the mean square error beside the mean absolute one."""
    gain_range: float = 0.0
    """As in `SsleTraining`."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a weight is negative.
        """
        for name in ("mask_weight", "square_weight", "gain_range"):
            if not getattr(self, name) >= 0.0:
                raise InvalidValueError(name, getattr(self, name), "0 or more")

    @classmethod
    def named(cls, size: str) -> "DualUNetTraining":
        """Return the schedule for a named size of the network.

        Raises:
            UnknownNameError: If there is no such size.
        """
        if size not in _TRAININGS:
            raise UnknownNameError("size of dual-unet", size, _TRAININGS)
        return _TRAININGS[size]


_TRAININGS = {
    "paper": DualUNetTraining(),
    "small": DualUNetTraining(
        schedule=Schedule(epochs=22, learning_rate=2e-3, per_step=True, warmup_steps=50, clip_norm=5.0, bfloat16=True),
        gain_range=0.15,
    ),
    "tiny": DualUNetTraining(schedule=Schedule(epochs=2, batch=2, learning_rate=2e-3)),
}


class DualUNetRecipe(Recipe):
    """Cross-entropy of the mask, and absolute plus square error of the depth where there is a truth.

    MaskNet's truth is where the depth has one; DepthNet is judged by its own output, not by the product, so that it cannot put
    MaskNet's doubt into its depth.
    """

    name = "dual-unet"

    def __init__(self, config: DualUNetConfig, training: DualUNetTraining) -> None:
        """Make the networks with random weights that depend on the seed alone."""
        self.schedule = training.schedule
        self._training = training
        self.dual = seeded(lambda: DualUNet(config), training.schedule.seed)
        self.network = self.dual

    @property
    def architecture(self) -> Mapping[str, object]:
        """The networks'."""
        return self.dual.config.architecture

    def augment(self, sample: Sample, rng: np.random.Generator) -> Sample:
        """Mirror and change the gain, if the training says so."""
        return flip_and_gain(sample, rng, self._training.gain_range) if self._training.gain_range else sample

    def loss(self, batch: Batch, progress: float) -> Loss:  # noqa: ARG002 - the weights do not change
        """Return the sum of both networks' losses."""
        truth, farthest = batch["depth_mm"], self.dual.config.farthest_mm
        mask = torch.isfinite(truth)
        with self.autocast(truth.device):
            output = self.dual(batch["image"])
        masking = functional.binary_cross_entropy_with_logits(output.mask_logit, mask.float())
        l1 = masked_l1(output.raw_depth_mm, truth, mask)
        error = (output.raw_depth_mm - torch.where(mask, truth, 0.0)) / farthest
        square = masked_mean(error.square(), mask)
        total = l1 / farthest + self._training.square_weight * square + self._training.mask_weight * masking
        return Loss(total=total, parts={"mae_mm": l1, "square": square, "mask": masking})

    def predict(self, batch: Batch) -> Prediction:
        """Return the product, valid where MaskNet says tissue."""
        with self.autocast(batch["image"].device):
            output = self.dual(batch["image"])
        return Prediction(depth_mm=output.depth_mm, valid=output.mask_logit > 0.0)


def train_dual_unet(
    dataset: DepthDataset, out: Path, *, config: DualUNetConfig, training: DualUNetTraining, **options: Unpack[TrainingOptions]
) -> Path:
    """Train and return the path of the weights in `out`; options and errors as for `train_single_stage`."""
    size = (config.height, config.width)
    return train_single_stage(dataset, out, lambda: DualUNetRecipe(config, training), size=size, **options)
