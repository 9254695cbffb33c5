"""Data sets on disk: a Zarr group with one chunk for each array of a frame, a checksum for each chunk, and a fixed plan.

| array | shape, type | what |
|---|---|---|
| one for each kind of picture | (N, ...) | see `frame_store` and `pair_store` |
| `tissue_seed` | (N,) int64 | number of the tissue |
| `split` | (N,) uint8 | index into `SPLITS` |
| `tool_in_view` | (N,) bool | frames with the instrument in view |
| `checksum` | (N, 32 K) uint8 | SHA-256 of the frame's K arrays; written last: a frame without it is not done |

A new store appears whole, without frames; a frame that is not done does not exist. Zarr writes chunks under other names and
renames them, so that several processes can fill a store at once and be killed at any moment. Attributes, plan and the files
beside the arrays are compared with their checksums when a store is opened, frames when they are read.
"""

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from laploop.assets.scope_optics import ScopeOptics
from laploop.configuration import from_plain
from laploop.errors import DatasetError, InvalidValueError, OutputError
from laploop.perception.data.dataset import SPLITS, DepthDataset
from laploop.perception.data.integrity import (
    CHECKSUM_BYTES,
    compare,
    new_folder,
    open_group,
    refusing_damage,
    sha256,
    sha256_of_json,
)

_PLAN = {"tissue_seed": "int64", "split": "uint8", "tool_in_view": "bool"}
_CHECKSUM_FILE = re.compile(r"c\.(\d+)\.0")
_LEFT_BEHIND = "*.partial"
"""Files that Zarr had not renamed yet when its process was killed."""
_CHUNK_NAMES = {"name": "default", "separator": "."}
_STORE_ALL_CHUNKS = {"array.write_empty_chunks": True}
"""By default Zarr omits chunks that equal the fill value, and returns another NaN than was written."""


class Store(DepthDataset):
    """A data set on disk; its subclasses say which arrays a frame has."""

    FORMAT: ClassVar[str]
    OLDER_FORMATS: ClassVar[tuple[str, ...]]
    """Formats that cannot be read any more."""
    READABLE_FORMATS: ClassVar[tuple[str, ...]] = ()
    """Older formats that can."""
    COMMAND: ClassVar[str]
    """The command that makes such a data set."""
    NOUN: ClassVar[str] = "frame"

    def __init__(self, path: Path, *, writable: bool = False) -> None:
        """Open a store and check everything except the frames, which are checked when they are read.

        Raises:
            MissingFileError: If there is none.
            DatasetError: If it is damaged, of another format, or made by an older version.
        """
        import zarr

        self.path = path
        with refusing_damage(f"data set {path}"), zarr.config.set(_STORE_ALL_CHUNKS):
            group = open_group(path, self.COMMAND, writable=writable)
            self._attributes = group.attrs.asdict()
            self._check_attributes()
            self._names = tuple(self._attributes["arrays"])
            self._arrays = {name: _checked(group, name, *expected) for name, expected in _layout(self._attributes).items()}
            self._plan = {name: self._arrays[name][:] for name in self._attributes["plan"]}
            for name, (_, checksum) in self._attributes["plan"].items():
                compare(name, self._plan[name].tobytes(), checksum)
            for name, checksum in self._attributes["files"].items():
                compare(name, (path / name).read_bytes(), checksum)
            self.optics = from_plain(ScopeOptics, self._attributes["optics"])
        self.tissue_seed, self.split, self.tool_in_view = (self._plan[name] for name in _PLAN)

    @classmethod
    def open(cls, path: Path, *, writable: bool = False) -> Self:
        """Open a store; see the constructor."""
        return cls(path, writable=writable)

    @classmethod
    def _create(
        cls,
        path: Path,
        *,
        arrays: Mapping[str, tuple[str, tuple[int, ...]]],
        plan: Mapping[str, NDArray[Any]],
        files: Mapping[str, bytes] | None = None,
        **attributes: Any,
    ) -> Self:
        """Make an empty store at a path that does not exist yet; it appears whole or not at all.

        `arrays` gives type and shape of each array of a frame, `plan` what is planned for each frame, (N,) each, `files` what
        lies beside the arrays, and `attributes` further attributes as JSON has them.
        """
        import zarr
        from zarr.codecs import BloscCodec, Crc32cCodec

        plan = {name: np.asarray(values, dtype=_PLAN.get(name)) for name, values in plan.items()}
        if len({values.shape for values in plan.values()}) > 1:
            raise InvalidValueError("shapes of the plan", [values.shape for values in plan.values()], "(frames,), all alike")
        attributes |= {"format": cls.FORMAT, "frames": len(plan["split"]), "arrays": dict(arrays)}
        attributes["plan"] = {name: (str(values.dtype), sha256(values.tobytes())) for name, values in plan.items()}
        files = files or {}
        attributes["files"] = {name: sha256(content) for name, content in files.items()}
        attributes["sha256"] = sha256_of_json(attributes)
        # The checksum is verified first: given a damaged chunk, Blosc may crash the process.
        codecs = (BloscCodec(cname="zstd", clevel=4, shuffle="bitshuffle"), Crc32cCodec())
        with new_folder(path) as partial:
            group: Any = zarr.open_group(store=partial, mode="w")
            for name, (dtype, shape) in _layout(attributes).items():
                if name in plan:
                    group.create_array(name, data=plan[name])
                    continue
                layout = {"shape": shape, "chunks": (1, *shape[1:]), "dtype": dtype, "chunk_key_encoding": _CHUNK_NAMES}
                group.create_array(name, compressors=codecs, **layout)
            for name, content in files.items():
                (partial / name).write_bytes(content)
            group.attrs.update(attributes)
        return cls(path, writable=True)

    @property
    def config(self) -> dict[str, Any]:
        """What the frames were made from."""
        return dict(self._attributes["config"])

    def done(self) -> NDArray[np.bool_]:
        """Return which frames are whole, (N,), from file names alone: fast enough to call after each frame."""
        done = np.zeros(len(self), dtype=bool)
        with refusing_damage(f"data set {self.path}"):
            for file in (self.path / "checksum").iterdir():
                if (match := _CHECKSUM_FILE.fullmatch(file.name)) and int(match[1]) < len(done):
                    done[int(match[1])] = True
        return done

    def count_done(self) -> int:
        """Return the number of whole frames."""
        return int(self.done().sum())

    def tissues_by_split(self) -> dict[str, int]:
        """Return the number of tissues of each split."""
        return {name: len(np.unique(self.tissue_seed[self.split == number])) for number, name in enumerate(SPLITS)}

    def verify(self, indices: Iterable[int]) -> None:
        """Compare all arrays of some frames with their checksums; see `DepthDataset`."""
        for index in indices:
            for name in self._names:
                self.read(name, int(index))

    def remove_left_behind(self) -> None:
        """Remove files that killed processes left half-written; no process may be writing."""
        for file in self.path.rglob(_LEFT_BEHIND):
            file.unlink(missing_ok=True)

    def read(self, name: str, index: int) -> NDArray[Any]:
        """Read one array of a frame and compare it with its checksum; see `DepthDataset`."""
        self._check_index(index)
        with refusing_damage(f"{name} of {self.NOUN} {index} of {self.path}"):
            values = np.asarray(self._arrays[name][index])
            begin = CHECKSUM_BYTES * self._names.index(name)
            checksums = np.asarray(self._arrays["checksum"][index])
            compare("data", values.tobytes(), checksums[begin : begin + CHECKSUM_BYTES].tobytes().hex())
        return values

    def _write(self, index: int, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Write all arrays of one frame, which is done when this returns."""
        self._check_index(index)
        for name in self._names:
            found = (str(arrays[name].dtype), arrays[name].shape)
            expected = (str(self._arrays[name].dtype), self._arrays[name].shape[1:])
            if found != expected:
                raise InvalidValueError(f"type and shape of {name}", found, str(expected))
        checksums = "".join(sha256(arrays[name].tobytes()) for name in self._names)
        try:
            for name in self._names:
                self._arrays[name][index] = arrays[name]
            self._arrays["checksum"][index] = np.frombuffer(bytes.fromhex(checksums), dtype=np.uint8)
        except OSError as error:
            message = f"cannot write {self.NOUN} {index} to {self.path}: {error}; what was saved stays"
            raise OutputError(message) from error

    def _check_attributes(self) -> None:
        found = self._attributes.get("format")
        if found in self.OLDER_FORMATS:
            raise DatasetError(f"data set {self.path} was made by an older version; make it anew with {self.COMMAND}")
        if found not in (self.FORMAT, *self.READABLE_FORMATS):
            raise DatasetError(
                f"data set {self.path} has the format {found!r}; allowed: {self.FORMAT!r}, made by {self.COMMAND}"
            )
        if self._attributes.pop("sha256", None) != sha256_of_json(self._attributes):
            raise DatasetError(f"data set {self.path} cannot be used: its attributes are not those that were written")


def _layout(attributes: Mapping[str, Any]) -> dict[str, tuple[str, tuple[int, ...]]]:
    """Return type and shape of every array of a store."""
    count, arrays = attributes["frames"], attributes["arrays"]
    return {
        **{name: (dtype, (count,)) for name, (dtype, _) in attributes["plan"].items()},
        **{name: (dtype, (count, *shape)) for name, (dtype, shape) in arrays.items()},
        "checksum": ("uint8", (count, CHECKSUM_BYTES * len(arrays))),
    }


def _checked(group: Any, name: str, dtype: str, shape: tuple[int, ...]) -> Any:
    if name not in group:
        raise ValueError(f"its array {name} is missing")
    array = group[name]
    if (str(array.dtype), array.shape) != (dtype, shape):
        raise ValueError(f"its array {name} is {array.dtype} of shape {array.shape}, not {dtype} of {shape}")
    return array
