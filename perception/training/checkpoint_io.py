"""Lightning's checkpoints as safetensors: tensors in the file, everything else as JSON in its header; nothing is unpickled."""

import json
from pathlib import Path
from typing import Any

import torch
from lightning.pytorch.plugins.io import CheckpointIO
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from laploop.errors import MissingFileError, OutputError, WeightsError
from laploop.perception.weights import refuse_pickle
from laploop.whole_file import whole_file

_KIND = "laploop-checkpoint-1"


class SafetensorsCheckpointIO(CheckpointIO):
    """Writes checkpoints atomically, and reads them."""

    def save_checkpoint(self, checkpoint: dict[str, Any], path: str | Path, storage_options: Any | None = None) -> None:
        """Write a checkpoint; raises an `OutputError` if the file cannot be written."""
        del storage_options
        target = Path(path)
        tensors: dict[str, Tensor] = {}
        text = json.dumps(_encode(checkpoint, tensors))
        with whole_file(target) as partial:
            try:
                save_file(tensors, partial, metadata={"kind": _KIND, "tree": text})
            except SafetensorError as error:
                raise OutputError(f"cannot write a checkpoint to {target}: {error}") from error

    def load_checkpoint(
        self,
        path: str | Path,
        map_location: Any | None = None,
        weights_only: bool | None = None,  # noqa: FBT001 - Lightning's signature
    ) -> dict[str, Any]:
        """Read a checkpoint, onto the CPU; Lightning moves it where it belongs.

        Raises:
            MissingFileError: If there is no such file.
            WeightsError: If it is a pickle, damaged, or no checkpoint.
        """
        del map_location, weights_only
        source = Path(path)
        if not source.is_file():
            raise MissingFileError("checkpoint", source, "start without --resume")
        refuse_pickle(source)
        try:
            with safe_open(source, framework="pt") as file:
                metadata = dict(file.metadata() or {})
                tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a mapping
            if metadata.get("kind") != _KIND:
                raise WeightsError(f"{source} is of kind {metadata.get('kind')!r}; allowed: {_KIND!r}")
            decoded = _decode(json.loads(metadata["tree"]), tensors)
        except (SafetensorError, OSError, ValueError, KeyError, TypeError, IndexError, RecursionError) as error:
            if isinstance(error, WeightsError):
                raise
            reason = " ".join(str(error).split())
            raise WeightsError(f"{source} is truncated or damaged ({reason}); allowed: a whole checkpoint") from error
        if not isinstance(decoded, dict):
            raise WeightsError(f"{source} holds a {type(decoded).__name__}; allowed: a whole checkpoint")
        return decoded

    def remove_checkpoint(self, path: str | Path) -> None:
        """Remove a checkpoint if it is there."""
        Path(path).unlink(missing_ok=True)


def _encode(value: Any, tensors: dict[str, Tensor]) -> Any:
    """Turn a tree of plain values and tensors into JSON; containers and tensors become a list that starts with their kind."""
    if isinstance(value, Tensor):
        name = str(len(tensors))
        # The optimiser's sums are as exact in any layout, but a resumed run must add in the same order as the first.
        channels_last = value.ndim == 4 and not value.is_contiguous()
        # A copy, since two entries that share memory cannot be in one file.
        tensors[name] = value.detach().cpu().contiguous().clone()
        return ["tensor", name, channels_last]
    if isinstance(value, dict):
        return ["dict", [[_encode(key, tensors), _encode(item, tensors)] for key, item in value.items()]]
    if isinstance(value, list | tuple):
        return ["list" if isinstance(value, list) else "tuple", [_encode(item, tensors) for item in value]]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise OutputError(f"a checkpoint cannot hold {value!r}; allowed: tensors and plain values")


def _decode(value: Any, tensors: dict[str, Tensor]) -> Any:
    if not isinstance(value, list):
        return value
    kind, content = value[0], value[1]
    if kind == "tensor":
        tensor = tensors[content]
        return tensor.contiguous(memory_format=torch.channels_last) if value[2] else tensor
    if kind == "dict":
        return {_decode(key, tensors): _decode(item, tensors) for key, item in content}
    items = [_decode(item, tensors) for item in content]
    if kind not in {"list", "tuple"}:
        raise WeightsError(f"unknown kind {kind!r} in a checkpoint; allowed: tensor, dict, list, tuple")
    return items if kind == "list" else tuple(items)
