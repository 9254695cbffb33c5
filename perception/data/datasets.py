"""Opens a data set of stripe frames of any kind."""

from collections.abc import Iterable
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from laploop.assets.scope_optics import ScopeOptics
from laploop.errors import DatasetError
from laploop.perception.data.frame_store import FrameStore
from laploop.perception.data.integrity import open_group, refusing_damage
from laploop.perception.data.pair_store import PairStore
from laploop.perception.geometry import Rig


@runtime_checkable
class DepthDataset(Protocol):
    """What data sets of frames and of pairs have in common; shapes as in `frame_store`.

    Whatever is read is compared with its checksum: a damaged frame raises a `DatasetError`.
    """

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

    def verify(self, indices: Iterable[int]) -> None:
        """Compare all arrays of some frames with their checksums; raise a `DatasetError` if one is damaged."""
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


def open_dataset(path: Path) -> FrameStore | PairStore:
    """Open a data set by its format and check everything except the frames, which are checked when they are read.

    Raises:
        MissingFileError: If there is none.
        DatasetError: If it is damaged, of an unknown format, or made by an older version.
    """
    commands = f"{FrameStore.COMMAND} or {PairStore.COMMAND}"
    with refusing_damage(f"data set {path}"):
        found = open_group(path, commands).attrs.get("format")
    for kind in (FrameStore, PairStore):
        if found in (kind.FORMAT, *kind.OLDER_FORMATS):
            return kind.open(path)
    raise DatasetError(f"data set {path} has the format {found!r}; allowed: one that {commands} made")
