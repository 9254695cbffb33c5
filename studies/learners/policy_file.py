"""Policies on disk: weights as safetensors, and a description as JSON. Neither runs code when it is read, as a pickle would."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from pydantic import JsonValue
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import nn

from laploop.errors import InvalidValueError, MissingFileError, WeightsError
from laploop.whole_file import whole_file

WEIGHTS = "policy.safetensors"
DESCRIPTION = "policy.json"


def save_policy(module: nn.Module, folder: Path, description: Mapping[str, JsonValue]) -> None:
    """Write the weights of a module, and with what it can be made again; the description comes last.

    Args:
        module: All of its parameters and buffers are kept.
        folder: Made if it is missing.
        description: Says how to make the module: its kind, sizes of layers.
    """
    # Tensors that share memory, as those of tied layers, would be refused.
    weights = {name: tensor.detach().cpu().clone().contiguous() for name, tensor in module.state_dict().items()}
    with whole_file(folder / WEIGHTS) as partial:
        save_file(weights, partial)
    with whole_file(folder / DESCRIPTION) as partial:
        partial.write_text(json.dumps(description, indent=2) + "\n", encoding="utf-8")


def read_description(folder: Path) -> dict[str, Any]:
    """Return the description of a saved policy.

    Raises:
        MissingFileError: If there is none.
        InvalidValueError: If it is damaged.
    """
    path = folder / DESCRIPTION
    if not path.is_file():
        raise MissingFileError("policy", path, "the folder that an example of examples/learning wrote to")
    try:
        description = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise InvalidValueError("description of a policy", str(path), "JSON") from error
    if not isinstance(description, dict):
        raise InvalidValueError("description of a policy", str(path), "a JSON object")
    return description


def load_weights(module: nn.Module, folder: Path) -> None:
    """Fill a module with the weights of a saved policy.

    Raises:
        MissingFileError: If there are none.
        WeightsError: If they are damaged, or another module's.
    """
    path = folder / WEIGHTS
    if not path.is_file():
        raise MissingFileError("weights", path, "the folder that an example of examples/learning wrote to")
    try:
        weights: dict[str, torch.Tensor] = load_file(path)
    except (SafetensorError, OSError) as error:
        raise WeightsError(f"{path} holds no weights: {error}") from error
    try:
        module.load_state_dict(weights)
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1].strip()
        raise WeightsError(f"{path} does not fit the policy that {DESCRIPTION} describes: {reason}") from error
