"""The contract of every depth network, and how a weights file becomes one."""

from pathlib import Path
from typing import Any, Protocol, Self

import torch
from torch import Tensor, nn

from laploop.configuration import from_plain
from laploop.errors import InvalidValueError, LaploopError, WeightsError
from laploop.perception.geometry import Rig
from laploop.perception.networks.configs import NetworkConfig
from laploop.perception.networks.specs import NetworkSpec
from laploop.perception.weights import load_weights, read_architecture


class DepthOutput(Protocol):
    """What a depth network says about a batch of images; networks add their own fields."""

    @property
    def depth_mm(self) -> Tensor:
        """Z-depth, (B, height, width)."""
        ...


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


def build_network(spec: NetworkSpec, rig: Rig, config: NetworkConfig) -> DepthNetwork:
    """Make a network with random weights for the images of a rig.

    Raises:
        InvalidValueError: If it takes images of another size than the rig's.
    """
    size = (rig.camera.height, rig.camera.width)
    if config.for_image(*size) != config:
        raise InvalidValueError("image (height, width) of the rig", size, f"that of the network, {config}")
    kind: type[DepthNetwork] = spec.imported(spec.network)
    return kind.for_rig(rig, config)


def load_network(spec: NetworkSpec, rig: Rig, weights: Path | None = None) -> DepthNetwork:
    """Make the network that a weights file describes, by default the shipped one.

    Raises:
        MissingFileError: If the file is not there.
        WeightsError: If it is damaged, of another network, or not safetensors.
        InvalidValueError: If the network takes images of another size than the rig's.
    """
    path = spec.weights if weights is None else Path(weights)
    described = read_architecture(path, spec.config.form)
    del described["format"]
    try:
        config = from_plain(spec.config, described)
    except (LaploopError, ValueError, RecursionError) as error:
        raise WeightsError(f"{path} describes an impossible network: {error}") from error
    network = build_network(spec, rig, config)
    tensors, _ = load_weights(path, config.architecture, network.state_dict())
    network.load_state_dict(tensors)
    return network


def random_network(spec: NetworkSpec, rig: Rig, size: str | None = None, *, seed: int = 0) -> DepthNetwork:
    """Make a network of a named size with random weights that depend on the seed alone.

    Raises:
        UnknownNameError: If there is no such size.
    """
    config = spec.sized(size).for_image(rig.camera.height, rig.camera.width)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return build_network(spec, rig, config)
