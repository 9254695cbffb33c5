"""Data sets of stripe frames with exact depth: a Zarr group, a chunk a frame.

| array | shape, type | what |
|---|---|---|
| `image` | (N, H, W) uint8 | grey values |
| `depth_mm` | (N, H, W) float32 | exact z-depth, NaN where nothing was hit |
| `lit` | (N, H, W) bool | the projector sees the point |
| `tissue_seed` | (N,) int64 | which tissue |
| `split` | (N,) uint8 | index into `SPLITS` |
| `tool_in_view` | (N,) bool | whether the instrument was put into the view |
| `scope` | (N,) int32, only in format 2 | index into the attribute `scopes` |
| `done` | (N,) uint8, a chunk each | 1 once the frame is whole; written last |

A store of format 1 was taken with one scope, its attribute `optics`; one of format 2 with several.

A frame that is not done does not exist. Chunks are written to the side and renamed by Zarr, so that several processes may
fill a store at once and be stopped at any moment.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
import zarr
from numpy.typing import NDArray

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.errors import InvalidValueError, MissingFileError, OutputError
from laploop.perception.geometry import Rig

FORMAT = "laploop-frames-1"
SCOPES_FORMAT = "laploop-frames-2"
"""Of a store whose frames were not all taken with one scope; whoever knows format 1 alone must not open it."""
FORMATS = (FORMAT, SCOPES_FORMAT)
SPLITS = ("train", "val", "test")
_PIXEL_ARRAYS: dict[str, tuple[str, Any]] = {"image": ("uint8", 0), "depth_mm": ("float32", np.nan), "lit": ("bool", False)}


class FrameStore:
    """One data set on disk."""

    def __init__(self, group: Any, path: Path) -> None:
        """Wrap an open Zarr group; use `create` or `open`."""
        self._group = group
        self.path = path
        self.tissue_seed: NDArray[np.int64] = group["tissue_seed"][:]
        self.split: NDArray[np.uint8] = group["split"][:]
        self.tool_in_view: NDArray[np.bool_] = group["tool_in_view"][:]
        self._scope: NDArray[np.int32] | None = group["scope"][:] if group.attrs.get("format") == SCOPES_FORMAT else None

    def __len__(self) -> int:
        """Return the number of planned frames."""
        return len(self.split)

    @classmethod
    def create(
        cls,
        path: Path,
        *,
        optics: ScopeOptics,
        tissue_seed: NDArray[np.int64],
        split: NDArray[np.uint8],
        tool_in_view: NDArray[np.bool_],
        config: Mapping[str, object],
        scopes: Sequence[ScopeOptics] = (),
        scope: NDArray[np.int32] | None = None,
    ) -> "FrameStore":
        """Make an empty store for the planned frames at a path that does not exist yet.

        `scopes` and, for each frame, its index `scope` into them are for frames that were not all taken with `optics`.

        Raises:
            OutputError: If the path exists or cannot be written.
            InvalidValueError: If a frame's scope is not among the scopes, or one of them has another size of image.
        """
        _check_scopes(optics, scopes, scope, len(split))
        if path.exists():
            raise OutputError(f"{path} exists already; give a new folder")
        frames, size = len(split), (optics.height, optics.width)
        try:
            path.mkdir(parents=True)
            group: Any = zarr.open_group(store=path, mode="w")
        except OSError as error:
            raise OutputError(f"cannot write a data set to {path}: {error}") from error
        for name, (dtype, fill) in _PIXEL_ARRAYS.items():
            group.create_array(name, shape=(frames, *size), chunks=(1, *size), dtype=dtype, fill_value=fill)
        for name, values in (("tissue_seed", tissue_seed), ("split", split), ("tool_in_view", tool_in_view)):
            group.create_array(name, data=values)
        group.create_array("done", shape=(frames,), chunks=(1,), dtype="uint8", fill_value=0)
        attributes: dict[str, Any] = {"optics": asdict(optics), "config": dict(config)}
        if scope is not None:
            group.create_array("scope", data=scope.astype(np.int32))
            attributes["scopes"] = [asdict(one) for one in scopes]
        # Written last: a store without its format was cut off while being made.
        group.attrs.update({**attributes, "format": FORMAT if scope is None else SCOPES_FORMAT})
        return cls(group, path)

    @classmethod
    def open(cls, path: Path, *, writable: bool = False) -> "FrameStore":
        """Open a store.

        Raises:
            MissingFileError: If there is none.
            InvalidValueError: If it is of another format.
        """
        if not (path / "zarr.json").is_file():
            raise MissingFileError("data set", path, "make one with `laploop synthesize`")
        group = zarr.open_group(store=path, mode="r+" if writable else "r")
        found = group.attrs.get("format")
        if found not in FORMATS:
            raise InvalidValueError(f"format of the data set {path}", found, " or ".join(FORMATS))
        return cls(group, path)

    @property
    def optics(self) -> ScopeOptics:
        """The nominal scope, which every frame of a store of format 1 was taken with."""
        return _scope_from_attributes(self._group.attrs["optics"])

    @cached_property
    def _rigs(self) -> list[Rig]:
        if self._scope is None:
            return [Rig.from_optics(self.optics)]
        return [Rig.from_optics(_scope_from_attributes(values)) for values in self._group.attrs["scopes"]]

    def rig(self, index: int) -> Rig:
        """Return the rig that took a frame.

        Raises:
            InvalidValueError: If there is no such frame.
        """
        if not 0 <= index < len(self):
            raise InvalidValueError("index of a frame", index, f"0 to {len(self) - 1}")
        return self._rigs[0 if self._scope is None else int(self._scope[index])]

    @property
    def config(self) -> dict[str, object]:
        """What the frames were made from."""
        return dict(cast("dict[str, object]", self._group.attrs["config"]))

    def done(self) -> NDArray[np.bool_]:
        """Return which frames are whole, read afresh."""
        return np.asarray(self._group["done"][:]) > 0

    def write(self, index: int, *, image: NDArray[np.uint8], depth_mm: NDArray[np.float32], lit: NDArray[np.bool_]) -> None:
        """Write one frame; it counts from the moment this returns.

        Raises:
            OutputError: If the disk refuses.
        """
        try:
            self._group["image"][index] = image
            self._group["depth_mm"][index] = depth_mm
            self._group["lit"][index] = lit
            self._group["done"][index] = 1
        except OSError as error:
            raise OutputError(f"cannot write frame {index} to {self.path}: {error}") from error

    def indices(self, split: str) -> NDArray[np.intp]:
        """Return the frames of a split that are done.

        Raises:
            InvalidValueError: If the split is unknown or has no frame.
        """
        if split not in SPLITS:
            raise InvalidValueError("split", split, f"one of {', '.join(SPLITS)}")
        chosen = np.flatnonzero((self.split == SPLITS.index(split)) & self.done())
        if not len(chosen):
            raise InvalidValueError(f"number of frames in split {split!r} of {self.path}", 0, "1 or more; finish the data set")
        return chosen

    def image(self, index: int) -> NDArray[np.uint8]:
        """Read one image (H, W)."""
        return np.asarray(self._group["image"][index])

    def depth_mm(self, index: int) -> NDArray[np.float32]:
        """Read one exact depth map (H, W)."""
        return np.asarray(self._group["depth_mm"][index])

    def lit(self, index: int) -> NDArray[np.bool_]:
        """Read where the projector reached (H, W)."""
        return np.asarray(self._group["lit"][index])


def _scope_from_attributes(attributes: object) -> ScopeOptics:
    values = cast("dict[str, Any]", attributes)
    return ScopeOptics(**{**values, "mask": StripeMask(**values["mask"])})


def _check_scopes(optics: ScopeOptics, scopes: Sequence[ScopeOptics], scope: NDArray[np.int32] | None, frames: int) -> None:
    if scope is None:
        if scopes:
            raise InvalidValueError("scope", None, "an index into scopes for each frame")
        return
    if scope.shape != (frames,) or frames == 0 or scope.min() < 0 or scope.max() >= len(scopes):
        raise InvalidValueError("scope", scope.shape, f"one index a frame ({frames}), each from 0 to {len(scopes) - 1}")
    for one in scopes:
        if (one.width, one.height) != (optics.width, optics.height):
            raise InvalidValueError("size of a scope's image", (one.width, one.height), f"{(optics.width, optics.height)}")
