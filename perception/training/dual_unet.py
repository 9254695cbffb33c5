"""Training of the prior method, MaskNet times DepthNet."""

from pathlib import Path

import torch
from torch.nn import functional

from laploop.configuration import to_plain
from laploop.perception.networks.configs import DualUNetConfig
from laploop.perception.networks.dual_unet import DualUNet
from laploop.perception.training.losses import masked_l1, masked_mean
from laploop.perception.training.recipe import Batch, Loss, Prediction, Recipe, seeded
from laploop.perception.training.run import TrainingRun
from laploop.perception.training.settings import DualUNetTraining


class DualUNetRecipe(Recipe):
    """Cross-entropy of the mask, and absolute plus square error of the depth where there is a truth.

    MaskNet's truth is where the depth has one; DepthNet is judged by its own output, not by the product, so that it cannot put
    MaskNet's doubt into its depth.
    """

    name = "dual-unet"

    def __init__(self, config: DualUNetConfig, training: DualUNetTraining) -> None:
        self.config: DualUNetConfig = config
        self.schedule, self.gain_range = training.schedule, training.gain_range
        self.settings = {name: value for name, value in to_plain(training).items() if name != "schedule"}
        self._training = training
        self.dual = seeded(lambda: DualUNet(config), training.schedule.seed)
        self.network = self.dual

    def loss(self, batch: Batch, progress: float) -> Loss:  # noqa: ARG002 - the weights do not change
        """Return the sum of both networks' losses."""
        truth, farthest = batch["depth_mm"], self.config.farthest_mm
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
        """Return the product, valid where MaskNet sees tissue."""
        with self.autocast(batch["image"].device):
            output = self.dual(batch["image"])
        return Prediction(depth_mm=output.depth_mm, valid=output.mask_logit > 0.0)


def train_dual_unet(run: TrainingRun, *, config: DualUNetConfig, training: DualUNetTraining) -> Path:
    """Train and return the path of the weights."""
    recipe = DualUNetRecipe(config, training)
    return run.fit(recipe, run.read(recipe))
