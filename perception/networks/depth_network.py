"""The contract of every depth network."""

from typing import Any, Self

from torch import nn

from laploop.perception.geometry import Rig
from laploop.perception.networks.configs import NetworkConfig


class DepthNetwork(nn.Module):
    """A network that is called with images (B, height, width), grey values 0-255 in float32, and perhaps a context."""

    config: NetworkConfig

    @classmethod
    def for_rig(cls, rig: Rig, config: Any) -> Self:  # noqa: ARG003 - for networks that are built for one rig
        """Make the network with random weights from torch's global generator."""
        return cls(config)

    def context(self, rig: Rig) -> Any:  # noqa: ARG002 - for networks that take the rig as an input
        """Return what the network is called with beside an image of this rig, a dataclass of tensors; None for nothing."""
        return None
