"""Common part of the trainings of networks that read the stripes' phase: augmentation, loss, validation."""

import hashlib
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from laploop.configuration import to_plain
from laploop.errors import check_file
from laploop.perception.data.datasets import DepthDataset
from laploop.perception.networks.depth_network import PhaseOutput
from laploop.perception.networks.phase_front import RigBatch, rig_numbers
from laploop.perception.training.augmentation import painted
from laploop.perception.training.recipe import Batch, Loss, Prediction, Recipe, Sample, flip_and_gain
from laploop.perception.training.settings import PhaseTraining
from laploop.perception.weights import load_weights
from laploop.perception.working_range import SLIP_FRACTION, WITHIN_MM, WORKING_RANGE_MM

_LEARNED_MM = (56.0, 160.0)
"""Depths are learned a little beyond the working range, so that its borders are no borders of what is known."""


class PhaseRecipe(Recipe):
    """Every sample brings its rig."""

    def __init__(self, training: PhaseTraining, origin: str = "random") -> None:
        """Take the settings, and where the weights to begin with come from, in words."""
        self.training = training
        self.schedule = training.schedule
        self.gain_range = training.gain_range
        plain = to_plain(training)
        # Its length may be changed on resume.
        del plain["schedule"]
        self.settings = {**plain, "first weights": origin}

    def extras(self, dataset: DepthDataset, index: int) -> Sample:
        """Return the numbers of the frame's rig."""
        return {"rig": np.array(rig_numbers(dataset.rig(index)))}

    def augment(self, sample: Sample, rng: np.random.Generator) -> Sample:
        """Mirror top to bottom, for which a rig with a centred camera stays the same, change the gain, and paint on some."""
        changed = flip_and_gain(sample, rng, self.gain_range)
        return painted(changed, rng) if rng.random() < self.training.painted_share else changed

    def adam_layers(self) -> Iterable[nn.Module]:
        """Return the output layers."""
        return [module for name, module in self.network.named_modules() if name.rpartition(".")[2] == "head"]

    def loss(self, batch: Batch, progress: float) -> Loss:  # noqa: ARG002 - the weights do not change
        """Return `phase_loss`."""
        return phase_loss(self.run(batch), batch["depth_mm"], self.training)

    def predict(self, batch: Batch) -> Prediction:
        """Return the depth, valid where a slip is unlikely."""
        output = self.run(batch)
        return Prediction(depth_mm=output.depth_mm, valid=output.valid(self.training.max_slip))

    def truth_mm(self, batch: Batch) -> Tensor:
        """Return the truth in the working range."""
        truth = batch["depth_mm"]
        return torch.where(_between(truth, WORKING_RANGE_MM), truth, torch.nan)

    def run(self, batch: Batch) -> PhaseOutput:
        """Run the network on a batch."""
        with self.autocast(batch["image"].device):
            output: PhaseOutput = self.network(batch["image"], rigs_of(batch))
        return output


def existing_weights(path: Path | None) -> Path | None:
    """Return the path of weights to begin with, if there is one; a `MissingFileError` if there is nothing at it."""
    return None if path is None else check_file("weights", path, "give another path, or train them with `laploop train`")


def origin_of(weights: Path | None) -> str:
    """Say which file weights to begin with come from, so that no other is taken on resume."""
    return "random" if weights is None else f"file {hashlib.sha256(weights.read_bytes()).hexdigest()[:16]}"


def take_weights(recipe: Recipe, path: Path) -> None:
    """Load weights into a recipe's network.

    Raises:
        WeightsError: If they are damaged or of another network.
    """
    recipe.network.load_state_dict(load_weights(path, recipe.architecture, recipe.network.state_dict())[0])


def rigs_of(batch: Batch) -> RigBatch:
    """Return the rigs of a batch."""
    return RigBatch(values=batch["rig"].to(torch.float64))


def phase_loss(output: PhaseOutput, truth_mm: Tensor, training: PhaseTraining) -> Loss:
    """Return the loss of a batch; NaN in the truth, (B, height, width), means that there is nothing.

    The sum of

    - the negative log-likelihood of a Laplace distribution, |error| / scale + ln(scale), where the depth is no slip,
    - the absolute error in millimetres where depth is learned, and that of the coarse depth, which few pixels would teach
      otherwise,
    - the cross-entropy of being a slip, over all pixels,
    - the cross-entropy of being within 1 mm, where the depth is no slip.
    """
    known, working = _between(truth_mm, _LEARNED_MM), _between(truth_mm, WORKING_RANGE_MM)
    truth = torch.where(known, truth_mm, 100.0)
    error = (output.depth_mm - truth).abs()
    slipped = ~working | (error.detach() > SLIP_FRACTION * truth)
    likelihood = error * torch.exp(-output.log_scale) + output.log_scale
    within = functional.binary_cross_entropy_with_logits(
        output.within_logit, (error.detach() <= WITHIN_MM).to(error.dtype), reduction="none"
    )
    slip = functional.binary_cross_entropy_with_logits(output.slip_logit, slipped.to(error.dtype))
    absolute = _mean(error, known)
    total = (
        _mean(likelihood, known & (error.detach() <= SLIP_FRACTION * truth))
        + training.l1_weight * absolute
        + training.coarse_weight * _mean((output.coarse_mm - truth).abs(), known)
        + training.slip_weight * slip
        + training.within_weight * _mean(within, ~slipped)
    )
    return Loss(total=total, parts={"mae_mm": absolute, "slip": slip})


def _between(depth_mm: Tensor, span: tuple[float, float]) -> Tensor:
    return (depth_mm >= span[0]) & (depth_mm <= span[1])


def _mean(values: Tensor, mask: Tensor) -> Tensor:
    """Return the mean under the mask, 0 where it is empty."""
    return (values * mask.to(values.dtype)).sum() / mask.sum().clamp(min=1)
