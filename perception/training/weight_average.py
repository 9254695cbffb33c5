"""The weighted average of several weight files of one architecture, as of the epochs of a training."""

import math
from collections.abc import Sequence
from pathlib import Path

import torch

from laploop.errors import InvalidValueError
from laploop.perception.inference.models import stored_config
from laploop.perception.network_specs import NetworkSpec
from laploop.perception.weights import load_weights, save_weights


def average_weights(spec: NetworkSpec, files: Sequence[Path], out: Path, *, shares: Sequence[float] = ()) -> None:
    """Write the average of weights of one network to `out`, by shares in any unit, equal by default; its notes name them.

    Weights along the way of a training that goes on from trained weights lie in one valley of the loss, and their middle often
    does better on what is rare than any of them (Izmailov et al., Averaging weights leads to wider optima, UAI 2018). Running
    statistics are averaged too; what is no floating point number is taken from the last file.

    Raises:
        InvalidValueError: If there is no file, a share is not above 0, or there is not one for each file.
        MissingFileError: If a file is missing.
        WeightsError: If one is damaged or of another architecture.
        OutputError: If `out` cannot be written.
    """
    parts = list(shares) or [1.0] * len(files)
    if not files or len(parts) != len(files):
        raise InvalidValueError("shares", parts, f"one for each of {len(files)} weight files, of which there is at least one")
    if not all(0.0 < part < math.inf for part in parts):
        raise InvalidValueError("shares", parts, "finite and above 0")
    architecture = stored_config(spec, files[0]).architecture
    first, _ = load_weights(files[0], architecture)
    loaded = [first, *(load_weights(path, architecture, first)[0] for path in files[1:])]
    total = math.fsum(parts)
    average = {
        name: sum((part / total * one[name].double() for one, part in zip(loaded, parts, strict=True)), torch.zeros(())).to(
            tensor.dtype
        )
        if tensor.is_floating_point()
        else tensor
        for name, tensor in loaded[-1].items()
    }
    named = ", ".join(f"{path.name}: {part:g}" for path, part in zip(files, parts, strict=True))
    save_weights(out, average, architecture, {"average": named})
