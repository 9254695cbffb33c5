"""What all data sets of stripe frames have in common."""

from abc import ABC, abstractmethod
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from laploop.assets.anatomy.families.registry import FAMILIES, TISSUE_FAMILY
from laploop.assets.anatomy.textures import OWN_TEXTURE, TEXTURES
from laploop.assets.scope_optics import ScopeOptics
from laploop.errors import InvalidValueError
from laploop.perception.geometry import Rig

SPLITS = ("train", "val", "test")


class DepthDataset(ABC):
    """Stripe frames with exact depth, or with that of a reference camera.

    Whatever is read is compared with its checksum: a damaged frame raises a `DatasetError`.
    """

    path: Path
    optics: ScopeOptics
    """The nominal scope."""
    split: NDArray[np.uint8]
    """(N,), index into `SPLITS`."""
    tissue_seed: NDArray[np.int64]
    """(N,), number of the tissue."""
    tool_in_view: NDArray[np.bool_]
    """(N,), frames with the instrument in view."""
    has_exact: bool = True
    """Whether there is exact depth; without it there is only that of a reference camera."""

    def __len__(self) -> int:
        return len(self.split)

    @abstractmethod
    def done(self) -> NDArray[np.bool_]:
        """Return which frames are whole, (N,), read afresh."""

    @abstractmethod
    def read(self, name: str, index: int) -> NDArray[Any]:
        """Read one array of a frame.

        Raises:
            InvalidValueError: If there is no such frame.
            DatasetError: If the frame is damaged or not done.
        """

    @abstractmethod
    def verify(self, indices: Iterable[int]) -> None:
        """Compare all arrays of some frames with their checksums.

        Raises:
            DatasetError: If one is damaged or not done.
        """

    @abstractmethod
    def rig(self, index: int) -> Rig:
        """Return the rig that took a frame.

        Raises:
            InvalidValueError: If there is no such frame.
        """

    def family(self, index: int) -> str:
        """Return the family of shapes that a frame shows, a name of `laploop.assets.anatomy` or `tissue`.

        Raises:
            InvalidValueError: If there is no such frame.
        """
        self._check_index(index)
        return TISSUE_FAMILY

    def texture(self, index: int) -> str:
        """Return the kind of texture that a frame shows, a name of `laploop.assets.anatomy` or `own`; raises as `family`."""
        self._check_index(index)
        return OWN_TEXTURE

    def shown(self) -> tuple[frozenset[str], frozenset[str]]:
        """Return the families and the textures of all frames, whether done or not."""
        return frozenset({TISSUE_FAMILY}), frozenset({OWN_TEXTURE})

    def check_learnable(self) -> None:
        """Check that networks may learn from this data set.

        Raises:
            InvalidValueError: If it shows a family or a texture that is held out.
        """
        families, textures = self.shown()
        kept = sorted(name for name in families if name in FAMILIES and FAMILIES[name].held_out)
        kept += sorted(name for name in textures if name in TEXTURES and TEXTURES[name].held_out)
        if kept:
            allowed = "none: what is held out shows how a network does on what it never learned from"
            raise InvalidValueError(f"held-out families and textures of {self.path}", ", ".join(kept), allowed)

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
        return self.read("image", index)

    def depth_mm(self, index: int) -> NDArray[np.float32]:
        """Read one exact depth map (H, W), z-depth, NaN where nothing was hit."""
        return self.read("depth_mm", index)

    def lit(self, index: int) -> NDArray[np.bool_]:
        """Read where the projector reached (H, W)."""
        return self.read("lit", index)

    def _check_index(self, index: int) -> None:
        if not 0 <= index < len(self):
            raise InvalidValueError("index of a frame", index, f"0 to {len(self) - 1}")


class ReferencedDataset(DepthDataset):
    """A data set with the depth of a reference camera beside the exact one."""

    def reference_depth_mm(self, index: int) -> NDArray[np.float32]:
        """Read the reference camera's depth, reprojected into the scope's image (H, W); NaN where the paper's M is 0."""
        return self.read("reference_depth_mm", index)
