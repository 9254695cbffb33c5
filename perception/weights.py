"""Reading and writing tensors as safetensors: atomic, checked, and nothing is ever unpickled."""

import hashlib
import json
import reprlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from laploop.errors import MissingFileError, OutputError, WeightsError
from laploop.whole_file import whole_file

_PICKLE_STARTS = (b"\x80", b"PK\x03\x04")
"""First bytes of a bare pickle, and of torch's archive of one."""


def architecture_hash(architecture: Mapping[str, object], tensors: Mapping[str, Tensor]) -> str:
    """Return a hash of the architecture's description and of every tensor's name, shape and type."""
    layout = {name: [str(tensor.dtype), *tensor.shape] for name, tensor in sorted(tensors.items())}
    text = json.dumps({"architecture": architecture, "layout": layout}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def save_weights(
    path: Path,
    tensors: Mapping[str, Tensor],
    architecture: Mapping[str, object],
    notes: Mapping[str, str] | None = None,
) -> None:
    """Write tensors to `path` with their architecture's hash, atomically.

    Raises:
        OutputError: If the file cannot be written.
    """
    metadata = {
        **(notes or {}),
        "architecture": json.dumps(architecture, sort_keys=True),
        "architecture_hash": architecture_hash(architecture, tensors),
    }
    with whole_file(path) as partial:
        try:
            save_file({name: tensor.detach().contiguous() for name, tensor in tensors.items()}, partial, metadata=metadata)
        except SafetensorError as error:
            raise OutputError(f"cannot write weights to {path}: {error}") from error
        partial.chmod(0o644)


def load_weights(
    path: Path, architecture: Mapping[str, object], expected: Mapping[str, Tensor] | None = None
) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Read tensors and their notes.

    Args:
        path: A file that `save_weights` wrote.
        architecture: What the file must describe.
        expected: A state dict of the network that will take the tensors, which must fit; None takes any.

    Raises:
        MissingFileError: If there is no such file.
        WeightsError: If it is a pickle, truncated or damaged, or holds another architecture.
    """
    with _opened(path) as file:
        metadata = dict(file.metadata() or {})
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a mapping
        described = json.loads(metadata.get("architecture", "null"))
    wanted = architecture_hash(architecture, tensors if expected is None else expected)
    if metadata.get("architecture_hash") != wanted or architecture_hash(architecture, tensors) != wanted:
        found = difference(described, architecture) or "its tensors have other names, shapes or types"
        raise WeightsError(f"{path} holds weights of another architecture: {found}")
    for name, tensor in tensors.items():
        if tensor.is_floating_point() and not bool(torch.isfinite(tensor).all()):
            raise WeightsError(f"{path} holds NaN or infinite values in {name!r}; allowed: finite values")
    return tensors, metadata


def read_architecture(path: Path, form: str) -> dict[str, Any]:
    """Return the description, of format `form`, of the architecture that a file's weights fit, without reading the weights.

    Raises:
        MissingFileError: If there is no such file.
        WeightsError: If it is a pickle, truncated or damaged, or of another format.
    """
    with _opened(path) as file:
        described = json.loads((file.metadata() or {}).get("architecture", "null"))
    found = described.get("format") if isinstance(described, dict) else None
    if found != form:
        raise WeightsError(f"{path} holds weights of format {reprlib.repr(found)}; allowed: {form!r}")
    return dict(described)


def difference(found: object, wanted: object) -> str:
    """Say in words in which fields a tree from JSON differs from the one that is wanted; empty if in none."""
    return "; ".join(islice(_differences(found, json.loads(json.dumps(wanted)), ""), 3))


def _differences(found: object, wanted: object, path: str) -> Iterator[str]:
    if isinstance(found, dict) and isinstance(wanted, dict):
        for key in dict.fromkeys([*wanted, *found]):
            yield from _differences(found.get(key), wanted.get(key), f"{path}.{key}".lstrip("."))
    elif found != wanted:
        yield f"{path or 'description'} is {reprlib.repr(found)}; allowed: {reprlib.repr(wanted)}"


def refuse_pickle(path: Path) -> None:
    """Raise a `WeightsError` for a file that starts like a pickle or torch's archive of one."""
    with path.open("rb") as stream:
        start = stream.read(9)
    # Safetensors begin with the header's length, whose lowest byte may be a pickle's first, and then the header, a JSON object.
    if start.startswith(_PICKLE_STARTS) and start[8:] != b"{":
        raise WeightsError(f"{path} is a pickle (or torch archive), which could run code; allowed: safetensors")


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open a file of weights; whatever is wrong with it while it is read becomes a `WeightsError`."""
    if not path.is_file():
        raise MissingFileError("weights", path, "give another path, or train them with `laploop train`")
    try:
        refuse_pickle(path)
        with safe_open(path, framework="pt") as file:
            yield file
    except (SafetensorError, OSError, ValueError, RecursionError) as error:
        if isinstance(error, WeightsError):
            raise
        reason = " ".join(str(error).split())
        raise WeightsError(f"{path} is truncated or not safetensors ({reason}); allowed: a whole safetensors file") from error
