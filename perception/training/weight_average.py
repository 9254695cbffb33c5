"""The weighted average of several weight files of one architecture, as of the epochs of a training."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from torch import Tensor

from laploop.errors import InvalidValueError
from laploop.perception.weights import load_weights, save_weights


def average_weights(
    parts: Sequence[tuple[Path, float]], architecture: Mapping[str, object], expected: Mapping[str, Tensor], out: Path
) -> None:
    """Write the average of weights that one training led through to `out`; its notes name the shares.

    Weights along the way of a training that goes on from trained weights lie in one valley of the loss, and their middle often
    does better on what is rare than any of them (Izmailov et al., Averaging weights leads to wider optima, UAI 2018). Running
    statistics are averaged too; what is no floating point number is taken from the last part.

    Args:
        parts: Files and their shares, in any unit.
        architecture: That all of them must have.
        expected: A state dict of the network, as for `load_weights`.
        out: File to write.

    Raises:
        InvalidValueError: If there is no part, or a share is not above 0.
        MissingFileError: If a file is missing.
        WeightsError: If one is damaged or of another architecture.
        OutputError: If `out` cannot be written.
    """
    if not parts:
        raise InvalidValueError("number of weight files", 0, "1 or more")
    for path, share in parts:
        if not 0.0 < share < math.inf:
            raise InvalidValueError(f"share of {path}", share, "finite and above 0")
    total = math.fsum(share for _, share in parts)
    loaded = [(load_weights(path, architecture, expected)[0], share / total) for path, share in parts]
    last = loaded[-1][0]
    average = {
        name: sum((share * tensors[name].double() for tensors, share in loaded), torch.zeros(())).to(tensor.dtype)
        if tensor.is_floating_point()
        else tensor
        for name, tensor in last.items()
    }
    save_weights(out, average, architecture, {"average": ", ".join(f"{path.name}: {share:g}" for path, share in parts)})
