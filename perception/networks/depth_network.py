"""The contract of every depth network."""

from dataclasses import dataclass
from typing import Any, ClassVar, Self

from torch import Tensor, nn

from laploop.perception.geometry import Rig
from laploop.perception.networks.configs import NetworkConfig


class DepthNetwork(nn.Module):
    """A network that is called with images (B, height, width), grey values 0-255 in float32, and perhaps a context."""

    config: NetworkConfig
    tolerates_bf16: ClassVar[bool] = False
    """Whether its depth hardly changes when all convolutions but the last are computed in bfloat16."""

    @classmethod
    def for_rig(cls, rig: Rig, config: Any) -> Self:  # noqa: ARG003 - for networks that are built for one rig
        """Make the network with random weights from torch's global generator."""
        return cls(config)

    def context(self, rig: Rig) -> Any:  # noqa: ARG002 - for networks that take the rig as an input
        """Return what the network is called with beside an image of this rig, a dataclass of tensors; None for nothing."""
        return None


@dataclass(frozen=True, kw_only=True, eq=False)
class PhaseOutput:
    """Output for a batch of a network that reads the stripes' phase, each (B, height, width)."""

    turns: Tensor
    """Turns of phase, b / (tau Z)."""
    depth_mm: Tensor
    log_scale: Tensor
    """Natural logarithm of the scale in millimetres of a Laplace distribution around `depth_mm`."""
