"""What estimators that run a network share: where weights lie, how a file becomes a network, and its form for inference."""

from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

import torch
from torch import nn

from laploop.errors import InvalidValueError
from laploop.perception.geometry import Rig
from laploop.perception.inference.depth_module import fold_batch_norms
from laploop.perception.networks.stored_config import stored_config
from laploop.perception.weights import load_weights, read_architecture

Network = TypeVar("Network", bound=nn.Module)


def shipped_weights(name: str) -> Path:
    """Return where the weights of a model that come with laploop lie; their card lies beside them."""
    return Path(str(files("laploop.assets") / "weights" / f"{name}.safetensors"))


def check_size(rig: Rig, height: int, width: int) -> None:
    """Check that a network takes images of the rig's camera.

    Raises:
        InvalidValueError: If it takes another size.
    """
    size = (rig.camera.height, rig.camera.width)
    if size != (height, width):
        raise InvalidValueError("image (height, width) of the rig", size, f"{(height, width)}, what the network was made for")


def load_network(path: Path, form: str, config: type[Any], make: Callable[[Any], Network]) -> Network:
    """Build the network that a file of weights describes, with those weights.

    Args:
        path: The file.
        form: Its format.
        config: Class of the network's configuration, read from the file.
        make: Makes a network from a configuration.

    Raises:
        MissingFileError: If the file is not there.
        WeightsError: If it is damaged, of another network, or not safetensors.
    """
    described = stored_config(config, read_architecture(path, form), path)
    network = make(described)
    tensors, _ = load_weights(path, described.architecture, network.state_dict())
    network.load_state_dict(tensors)
    return network


def for_inference(network: Network, device: torch.device) -> Network:
    """Put a network into its form for inference, in place: batch normalisations folded, channels last, no gradients."""
    network.eval()
    fold_batch_norms(network)
    network.to(device)
    network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    network.requires_grad_(requires_grad=False)
    return network
