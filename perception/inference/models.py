"""Depth networks made from their entries, with trained weights or without."""

from collections.abc import Callable
from pathlib import Path

import torch

from laploop.configuration import from_plain
from laploop.errors import LaploopError, WeightsError
from laploop.perception.geometry import Rig
from laploop.perception.inference.depth_module import DepthModule
from laploop.perception.network_specs import NETWORKS, NetworkSpec
from laploop.perception.networks.configs import NetworkConfig
from laploop.perception.networks.depth_network import DepthNetwork
from laploop.perception.weights import difference, load_weights, read_architecture


def random_module(name: str, rig: Rig, size: str | None = None, *, seed: int = 0) -> DepthModule:
    """Make a network with random weights, by name and size; how fast it runs does not depend on them."""
    spec = NETWORKS.get(name)
    config = spec.sized(size).for_image(rig.camera.height, rig.camera.width)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = build_network(spec, rig, config)
    return DepthModule(network, network.context(rig), outputs=spec.outputs)


def trained_module(name: str, rig: Rig, weights: Path | None = None) -> DepthModule:
    """Make a network with trained weights, by default the shipped ones; whose header describes its size.

    Raises:
        UnknownNameError: If there is no such network.
        MissingFileError: If the file is not there.
        WeightsError: If it is damaged, of another network, or not safetensors.
        InvalidValueError: If the network takes images of another size than the rig's.
    """
    spec = NETWORKS.get(name)
    network = load_network(spec, rig, weights)
    return DepthModule(network, network.context(rig), outputs=spec.outputs)


def build_network(spec: NetworkSpec, rig: Rig, config: NetworkConfig) -> DepthNetwork:
    """Make a network with random weights for the images of a rig; refuses images of another size than its own."""
    config.check_image("the rig", (rig.camera.height, rig.camera.width))
    make: Callable[[NetworkConfig], DepthNetwork] = spec.imported(spec.network)
    return make(config)


def load_network(spec: NetworkSpec, rig: Rig, weights: Path | None = None) -> DepthNetwork:
    """Make the network that a weights file describes, by default the shipped one.

    Raises:
        MissingFileError: If the file is not there.
        WeightsError: If it is damaged, of another network, or not safetensors.
        InvalidValueError: If the network takes images of another size than the rig's.
    """
    path = spec.weights if weights is None else Path(weights)
    network = build_network(spec, rig, stored_config(spec, path))
    tensors, _ = load_weights(path, network.config.architecture, network.state_dict())
    network.load_state_dict(tensors)
    return network


def stored_config(spec: NetworkSpec, path: Path) -> NetworkConfig:
    """Return the configuration in the header of a weights file; raises as `load_network` does."""
    described = read_architecture(path, spec.config.form)
    try:
        config = from_plain(spec.config, {name: value for name, value in described.items() if name != "format"})
    except (LaploopError, ValueError, RecursionError) as error:
        raise WeightsError(f"{path} describes an impossible network: {error}") from error
    if missing := difference(described, config.architecture):
        raise WeightsError(f"{path} does not describe its network in full: {missing}")
    return config
