"""The contract of every depth network."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from laploop.perception.geometry import Rig
from laploop.perception.networks.configs import NetworkConfig
from laploop.perception.working_range import WORKING_RANGE_MM


class DepthNetwork(nn.Module):
    """A network that is called with images (B, height, width), grey values 0-255 in float32, and perhaps a context."""

    config: NetworkConfig
    tolerates_bf16: ClassVar[bool] = False
    """Whether its depth hardly changes when all convolutions but the last are computed in bfloat16."""

    def context(self, rig: Rig) -> Any:  # noqa: ARG002 - for networks that take the rig as an input
        """Return what the network is called with beside an image of this rig, a dataclass of tensors; None for nothing."""
        return None


@dataclass(frozen=True, kw_only=True, eq=False)
class PhaseOutput:
    """Output for a batch of a network that reads the stripes' phase, each (B, height, width)."""

    turns: Tensor
    """Turns of phase, b / (tau Z)."""
    depth_mm: Tensor
    coarse_mm: Tensor
    """Depth that does not follow from the phase: it picks the stripe order, and replaces a phase of no use."""
    log_scale: Tensor
    """Natural logarithm of the scale in millimetres of a Laplace distribution around `depth_mm`, of pixels that do not slip."""
    slip_logit: Tensor
    """Logarithm of the odds that the depth is a slip: off by more than a tenth, or the true one outside the working range."""
    within_logit: Tensor
    """Logarithm of the odds that a depth that is no slip is within 1 mm of the true one."""

    @cached_property
    def slip(self) -> Tensor:
        """Probability that the depth is a slip."""
        return torch.sigmoid(self.slip_logit)

    @property
    def confidence(self) -> Tensor:
        """Probability that the depth is within 1 mm of the true one."""
        return torch.sigmoid(self.within_logit) * torch.sigmoid(-self.slip_logit)

    def valid(self, max_slip: float) -> Tensor:
        """Return where the depth lies in the working range and is a slip with at most this probability."""
        near, far = WORKING_RANGE_MM
        return (self.slip <= max_slip) & (self.depth_mm >= near) & (self.depth_mm <= far)
