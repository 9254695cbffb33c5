"""Data sets of stripe frames with exact depth: a Zarr group, a chunk a frame.

| array | shape, type | what |
|---|---|---|
| `image` | (N, H, W) uint8 | grey values |
| `depth_mm` | (N, H, W) float32 | exact z-depth, NaN where nothing was hit |
| `lit` | (N, H, W) bool | the projector sees the point |
| `tissue_seed` | (N,) int64 | which tissue |
| `split` | (N,) uint8 | index into `SPLITS` |
| `tool_in_view` | (N,) bool | whether the instrument was put into the view |
| `done` | (N,) uint8, a chunk each | 1 once the frame is whole; written last |

A frame that is not done does not exist. Chunks are written to the side and renamed by Zarr, so that several processes may
fill a store at once and be stopped at any moment.
"""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, cast

import numpy as np
import zarr
from numpy.typing import NDArray

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.errors import InvalidValueError, MissingFileError, OutputError

FORMAT = "laploop-frames-1"
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
    ) -> "FrameStore":
        """Make an empty store for the planned frames at a path that does not exist yet.

        Raises:
            OutputError: If the path exists or cannot be written.
        """
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
        # Written last: a store without its format was cut off while being made.
        group.attrs.update({"optics": asdict(optics), "config": dict(config), "format": FORMAT})
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
        if found != FORMAT:
            raise InvalidValueError(f"format of the data set {path}", found, FORMAT)
        return cls(group, path)

    @property
    def optics(self) -> ScopeOptics:
        """The scope that the frames were taken with."""
        values = cast("dict[str, Any]", self._group.attrs["optics"])
        return ScopeOptics(**{**values, "mask": StripeMask(**values["mask"])})

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
