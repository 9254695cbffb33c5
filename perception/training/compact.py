"""Training of the compact network, in one stage: likelihood and absolute error in millimetres."""

from pathlib import Path

import torch
from torch import Tensor

from laploop.perception.geometry import Rig
from laploop.perception.networks.compact_unet import CompactUNet
from laploop.perception.networks.configs import CompactConfig
from laploop.perception.networks.depth_network import PhaseOutput
from laploop.perception.training.recipe import Batch, Loss, Prediction, seeded
from laploop.perception.training.run import TrainingRun
from laploop.perception.training.scale_recipe import ScaleRecipe
from laploop.perception.training.settings import CompactTraining

_NEAREST_MM, _FARTHEST_MM = 20.0, 250.0
"""Truth outside is not learned from: the network's turns end about there."""


class CompactRecipe(ScaleRecipe):
    """A network for one rig."""

    name = "compact"

    def __init__(self, rig: Rig, config: CompactConfig, training: CompactTraining) -> None:
        self.config, self.schedule = config, training.schedule
        self.settings = {"l1_weight": training.l1_weight, "gain_range": training.gain_range}
        self.gain_range = training.gain_range
        self._l1_weight = training.l1_weight
        self.compact = seeded(lambda: CompactUNet(rig, config), training.seed)
        self.network = self.compact

    def loss(self, batch: Batch, progress: float) -> Loss:  # noqa: ARG002 - the weights do not change
        """Return `laplace_loss`."""
        return laplace_loss(self._run(batch), batch["depth_mm"], self._l1_weight)

    def predict(self, batch: Batch) -> Prediction:
        """Return the depth."""
        return self.prediction(self._run(batch))

    def _run(self, batch: Batch) -> PhaseOutput:
        with self.autocast(batch["image"].device):
            output: PhaseOutput = self.compact(batch["image"])
        return output


def laplace_loss(output: PhaseOutput, truth_mm: Tensor, l1_weight: float) -> Loss:
    """Return the loss over the pixels with usable truth.

    It is the negative log-likelihood of a Laplace distribution, |error| / scale + ln(scale), plus the absolute error.
    """
    known = (truth_mm >= _NEAREST_MM) & (truth_mm <= _FARTHEST_MM)
    error = (output.depth_mm - torch.where(known, truth_mm, 100.0)).abs()
    loss = error * (torch.exp(-output.log_scale) + l1_weight) + output.log_scale
    weight = known.to(loss.dtype) / known.sum().clamp(min=1)
    return Loss(total=(loss * weight).sum(), parts={"mae_mm": (error * weight).sum()})


def train_compact(run: TrainingRun, *, config: CompactConfig, training: CompactTraining) -> Path:
    """Train and return the path of the weights."""
    recipe = CompactRecipe(Rig.from_optics(run.dataset.optics), config, training)
    return run.fit(recipe, run.read(recipe))
