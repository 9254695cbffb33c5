"""Depth networks by name and size, in inference form, with trained weights or without."""

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import torch
from torch import nn

from laploop.errors import UnknownNameError
from laploop.perception.geometry import Rig
from laploop.perception.inference.depth_module import DepthModule
from laploop.perception.weights import load_weights, read_architecture

Maker = Callable[[Rig, str], tuple[nn.Module, Any, tuple[str, ...]]]

_DEPTH, _DEPTH_AND_SCALE = ("depth_mm",), ("depth_mm", "log_scale")


def _compact(rig: Rig, size: str) -> tuple[nn.Module, Any, tuple[str, ...]]:
    from laploop.perception.networks.compact_unet import CompactConfig, CompactUNet

    config = CompactConfig(widths=(8, 8)) if size == "tiny" else CompactConfig()
    return CompactUNet(rig, config), None, _DEPTH_AND_SCALE


def _ssle(rig: Rig, size: str) -> tuple[nn.Module, Any, tuple[str, ...]]:
    from laploop.perception.networks.ssle_network import SsleConfig, SsleNetwork

    config = SsleConfig.named(size, height=rig.camera.height, width=rig.camera.width)
    return SsleNetwork(config), None, _DEPTH


def _dual_unet(rig: Rig, size: str) -> tuple[nn.Module, Any, tuple[str, ...]]:
    from laploop.perception.networks.dual_unet import DualUNet, DualUNetConfig

    config = DualUNetConfig.named(size, height=rig.camera.height, width=rig.camera.width)
    return DualUNet(config), None, _DEPTH


def _ssle_phase(rig: Rig, size: str) -> tuple[nn.Module, Any, tuple[str, ...]]:
    from laploop.perception.networks.ssle_phase import SslePhase, SslePhaseConfig
    from laploop.perception.networks.ssle_phase_front import RigBatch

    config = SslePhaseConfig(height=rig.camera.height, width=rig.camera.width)
    if size == "tiny":
        config = replace(config, reader_widths=(8, 8), reader_fine_width=8, refiner_widths=(8, 8))
    network = SslePhase(config)
    return network, network.prepare(RigBatch.from_rigs([rig])), _DEPTH_AND_SCALE


_MODELS: Mapping[str, tuple[Maker, tuple[str, ...]]] = {
    "compact": (_compact, ("small", "tiny")),
    "ssle": (_ssle, ("small", "paper", "tiny")),
    "dual-unet": (_dual_unet, ("small", "paper", "tiny")),
    "ssle-phase": (_ssle_phase, ("small", "tiny")),
}

NETWORK_NAMES: tuple[str, ...] = tuple(_MODELS)
"""Estimators whose depth comes from a network that can be run and exported on its own."""


def network_sizes(name: str) -> tuple[str, ...]:
    """Return the sizes of a network, the usual one first.

    Raises:
        UnknownNameError: If there is no such network.
    """
    if name not in _MODELS:
        raise UnknownNameError("network", name, NETWORK_NAMES)
    return _MODELS[name][1]


def random_module(name: str, rig: Rig, size: str | None = None, *, seed: int = 0) -> DepthModule:
    """Make a network with random weights; how fast it runs does not depend on them.

    Raises:
        UnknownNameError: If there is no such network or size.
    """
    sizes = network_sizes(name)
    size = sizes[0] if size is None else size
    if size not in sizes:
        raise UnknownNameError(f"size of {name}", size, sizes)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network, context, outputs = _MODELS[name][0](rig, size)
    return DepthModule(network, context, outputs=outputs)


def trained_module(name: str, rig: Rig, weights: Path | None = None) -> DepthModule:
    """Make a network with trained weights, by default the shipped ones; the file tells the size.

    Raises:
        UnknownNameError: If there is no such network.
        MissingFileError: If the file is not there.
        WeightsError: If it is damaged, of another architecture, or not safetensors.
    """
    sizes = network_sizes(name)
    path = Path(str(files("laploop.assets") / "weights" / f"{name}.safetensors")) if weights is None else Path(weights)
    module = random_module(name, rig, sizes[0])
    found = read_architecture(path, str(_architecture(module)["format"]))
    for size in sizes[1:]:
        if _architecture(module) == found:
            break
        other = random_module(name, rig, size)
        if _architecture(other) == found:
            module = other
    tensors, _ = load_weights(path, _architecture(module), module.network.state_dict())
    module.network.load_state_dict(tensors)
    return module


def _architecture(module: DepthModule) -> dict[str, Any]:
    """Return the description as JSON gives it back, lists for tuples."""
    config: Any = module.network.config
    described: dict[str, Any] = json.loads(json.dumps(config.architecture))
    return described
