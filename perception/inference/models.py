"""Depth networks by name and size, in inference form, with trained weights or without."""

from pathlib import Path

from laploop.perception.geometry import Rig
from laploop.perception.inference.depth_module import DepthModule
from laploop.perception.networks.depth_network import load_network, random_network
from laploop.perception.networks.specs import NETWORKS


def random_module(name: str, rig: Rig, size: str | None = None, *, seed: int = 0) -> DepthModule:
    """Make a network with random weights; how fast it runs does not depend on them.

    Raises:
        UnknownNameError: If there is no such network or size.
    """
    spec = NETWORKS.get(name)
    network = random_network(spec, rig, size, seed=seed)
    return DepthModule(network, network.context(rig), outputs=spec.outputs)


def trained_module(name: str, rig: Rig, weights: Path | None = None) -> DepthModule:
    """Make a network with trained weights, by default the shipped ones; the file tells its size.

    Raises:
        UnknownNameError: If there is no such network.
        MissingFileError: If the file is not there.
        WeightsError: If it is damaged, of another network, or not safetensors.
        InvalidValueError: If the network takes images of another size than the rig's.
    """
    spec = NETWORKS.get(name)
    network = load_network(spec, rig, weights)
    return DepthModule(network, network.context(rig), outputs=spec.outputs)
