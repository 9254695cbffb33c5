"""Opens a data set of stripe frames, whatever made it."""

from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
import zarr
from numpy.typing import NDArray

from laploop.assets.scope_optics import ScopeOptics
from laploop.errors import InvalidValueError, MissingFileError
from laploop.perception.data import frame_store, pair_store
from laploop.perception.data.frame_store import FrameStore
from laploop.perception.data.pair_store import PairStore
from laploop.perception.geometry import Rig


@runtime_checkable
class DepthDataset(Protocol):
    """What rendered frames and collected pairs have in common; shapes as in `frame_store`."""

    path: Path
    split: NDArray[np.uint8]
    """(N,), index into `SPLITS`."""
    tissue_seed: NDArray[np.int64]
    """(N,)."""
    tool_in_view: NDArray[np.bool_]
    """(N,)."""

    def __len__(self) -> int:
        """Return the number of planned frames."""
        ...

    @property
    def optics(self) -> ScopeOptics:
        """The nominal scope."""
        ...

    def done(self) -> NDArray[np.bool_]:
        """Return which frames are whole."""
        ...

    def indices(self, split: str) -> NDArray[np.intp]:
        """Return the frames of a split that are done."""
        ...

    def image(self, index: int) -> NDArray[np.uint8]:
        """Read one image (H, W)."""
        ...

    def depth_mm(self, index: int) -> NDArray[np.float32]:
        """Read one exact depth map (H, W)."""
        ...

    def lit(self, index: int) -> NDArray[np.bool_]:
        """Read where the projector reached (H, W)."""
        ...

    def rig(self, index: int) -> Rig:
        """Return the rig that took a frame."""
        ...


@runtime_checkable
class ReferencedDataset(DepthDataset, Protocol):
    """A data set with the depth of a reference camera beside the exact one."""

    def reference_depth_mm(self, index: int) -> NDArray[np.float32]:
        """Read one depth map (H, W) of the reference camera, reprojected into the scope's frame."""
        ...


def open_dataset(path: Path) -> DepthDataset:
    """Open a data set, by its format, as a `FrameStore` or a `PairStore`.

    Raises:
        MissingFileError: If there is none.
        InvalidValueError: If it is of no format that is known here.
    """
    if not (path / "zarr.json").is_file():
        raise MissingFileError("data set", path, "make one with `laploop synthesize` or `laploop collect`")
    found = zarr.open_group(store=path, mode="r").attrs.get("format")
    if found == pair_store.FORMAT:
        return PairStore.open(path)
    if found in frame_store.FORMATS:
        return FrameStore.open(path)
    raise InvalidValueError(f"format of the data set {path}", found, " or ".join((*frame_store.FORMATS, pair_store.FORMAT)))
