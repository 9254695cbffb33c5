"""What a network must bring to be trained by `laploop.perception.training.fit`."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from laploop.perception.data.datasets import DepthDataset
from laploop.perception.networks.configs import NetworkConfig
from laploop.perception.training.settings import Schedule

Network = TypeVar("Network", bound=nn.Module)

Sample = dict[str, NDArray[Any]]
"""One frame: `image` (H, W) uint8, `depth_mm` (H, W) float32 with NaN where there is no truth, and the recipe's extras."""

Batch = dict[str, Tensor]
"""A stack of samples with the same keys; `image` is float32, still grey values from 0 to 255."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Loss:
    """What one batch costs."""

    total: Tensor
    """The scalar to be lowered."""
    parts: Mapping[str, Tensor]
    """Scalars for the log, by name; detached by the harness."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Prediction:
    """The network's output for a batch, for validation."""

    depth_mm: Tensor
    """(B, H, W)."""
    valid: Tensor
    """(B, H, W) bool, where the network marks its depth valid."""


class Recipe(ABC):
    """A network with its loss, schedule and augmentation; one stage of a training.

    The harness owns the loop, the optimiser, the order of the frames, logs, checkpoints and machines. All that is random must
    come from the generator that `augment` is given, or from torch's global one, which is set anew at every batch: then a
    resumed training ends in the same bits as one that was never interrupted.
    """

    name: str
    """The weights become `<name>.safetensors`."""
    error_unit: str = "mm"
    """Unit of what `predict` returns, for the progress bar."""
    config: NetworkConfig
    """Of the whole network, of which `network` may be a part."""
    network: nn.Module
    """All that is saved; parameters that do not require gradients stay as they are."""
    schedule: Schedule
    settings: Mapping[str, object] = {}
    """What decides the result beside architecture, schedule and frames, as plain data: another one is not resumed."""
    gain_range: float = 0.0
    """Images are made brighter or darker by up to this fraction, and mirrored; 0 for no augmentation."""
    variants: int = 0
    """Augmented variants of a frame that the epochs take in turn; 0 for a new one in every epoch. Where it is set, `derive` is
    called once for each and what it returns is kept in memory."""

    @property
    def architecture(self) -> Mapping[str, object]:
        """What decides whether weights fit, as plain data with a `format`."""
        return self.config.architecture

    @abstractmethod
    def loss(self, batch: Batch, progress: float) -> Loss:
        """Return the loss of a batch; `progress` is the fraction of the training that is done."""

    @abstractmethod
    def predict(self, batch: Batch) -> Prediction:
        """Return the depth of a batch, called without gradients and in evaluation mode."""

    def truth_mm(self, batch: Batch) -> Tensor:
        """Return what predictions are compared with in validation, (B, H, W), NaN where there is nothing."""
        return batch["depth_mm"]

    def extras(self, dataset: DepthDataset, index: int) -> Sample:  # noqa: ARG002 - for recipes that need more
        """Return more arrays of a frame than image and depth; read once, before training."""
        return {}

    def augment(self, sample: Sample, rng: np.random.Generator) -> Sample:
        """Return a changed copy of a training sample, by default of `flip_and_gain`; called for every frame and epoch."""
        return flip_and_gain(sample, rng, self.gain_range) if self.gain_range else sample

    def derive(self, sample: Sample) -> Sample:  # noqa: ARG002 - for recipes that need it
        """Return more arrays of an augmented sample that no training changes, such as the output of frozen layers.

        Called only where `variants` is set. Must depend on nothing but the sample, so that a resumed training repeats it.
        """
        return {}

    def parameters(self) -> Iterable[nn.Parameter]:
        """Return what is learned."""
        return [parameter for parameter in self.network.parameters() if parameter.requires_grad]

    def adam_layers(self) -> Iterable[nn.Module]:
        """Return layers whose kernels Adam should move where the others are Muon's: those that produce the output."""
        return ()

    def autocast(self, device: torch.device) -> AbstractContextManager[Any]:
        """Return the context in which the network, but not its loss, should run."""
        return torch.autocast(device.type, dtype=torch.bfloat16, enabled=self.schedule.bfloat16)


def flip_and_gain(sample: Sample, rng: np.random.Generator, gain_range: float) -> Sample:
    """Mirror a sample top to bottom half of the time, which leaves a rig with a baseline along x the same, and change its gain.

    Every array with two dimensions or more is mirrored along the first of its last two; others are left alone.
    """
    changed = dict(sample)
    if rng.random() < 0.5:
        changed = {key: value[..., ::-1, :] if value.ndim >= 2 else value for key, value in changed.items()}
    gain = 1.0 + gain_range * rng.uniform(-1.0, 1.0)
    changed["image"] = np.clip(np.round(changed["image"] * np.float32(gain)), 0.0, 255.0).astype(np.uint8)
    return changed


def seeded(make: Callable[[], Network], seed: int) -> Network:
    """Make a network whose first weights depend on the seed alone, laid out for convolutions on the CPU."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = make()
    network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return network
