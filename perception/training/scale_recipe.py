"""Common part of the trainings of networks that predict the scale of their own error."""

import math

import numpy as np
import torch
from torch import Tensor

from laploop.perception.networks.depth_network import PhaseOutput
from laploop.perception.training.recipe import Batch, Prediction, Recipe, Sample, flip_and_gain


class ScaleRecipe(Recipe):
    """Augmentation and validation; the loss is the network's own."""

    max_scale_mm: float = 2.0
    """In validation, a pixel is valid where its predicted scale is at most this."""

    def augment(self, sample: Sample, rng: np.random.Generator) -> Sample:
        """Mirror top to bottom, for which a rig with a centred camera stays the same, and change the gain, if only by 0."""
        return flip_and_gain(sample, rng, self.gain_range)

    def truth_mm(self, batch: Batch) -> Tensor:
        """Return the truth at 60 to 140 mm, where the loop works."""
        truth = batch["depth_mm"]
        return torch.where((truth >= 60.0) & (truth <= 140.0), truth, torch.nan)

    def prediction(self, output: PhaseOutput) -> Prediction:
        """Return the depth, valid where the network expects to be near enough."""
        return Prediction(depth_mm=output.depth_mm, valid=output.log_scale <= math.log(self.max_scale_mm))
