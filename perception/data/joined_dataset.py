"""Several data sets as one, for training on all of them."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from laploop.assets.scope_optics import ScopeOptics
from laploop.errors import InvalidValueError
from laploop.perception.data.datasets import DepthDataset, ReferencedDataset
from laploop.perception.geometry import Rig


class JoinedDataset:
    """The frames of several data sets, one set after another; each keeps its splits."""

    def __init__(self, parts: Sequence[DepthDataset]) -> None:
        """Join open data sets.

        Raises:
            InvalidValueError: If there is none, or they differ in the size of their images.
        """
        if not parts:
            raise InvalidValueError("number of data sets", 0, "1 or more")
        size = (parts[0].optics.height, parts[0].optics.width)
        for part in parts[1:]:
            other = (part.optics.height, part.optics.width)
            if other != size:
                raise InvalidValueError(f"image (height, width) of {part.path}", other, f"{size}, as in {parts[0].path}")
        self._parts = tuple(parts)
        self._starts = np.cumsum([0, *(len(part) for part in parts)])
        self.path = Path("+".join(str(part.path) for part in parts))
        self.split: NDArray[np.uint8] = np.concatenate([part.split for part in parts])
        self.tissue_seed: NDArray[np.int64] = np.concatenate([part.tissue_seed for part in parts])
        self.tool_in_view: NDArray[np.bool_] = np.concatenate([part.tool_in_view for part in parts])

    def __len__(self) -> int:
        """Return the number of planned frames."""
        return int(self._starts[-1])

    @property
    def optics(self) -> ScopeOptics:
        """The nominal scope of the first data set."""
        return self._parts[0].optics

    def done(self) -> NDArray[np.bool_]:
        """Return which frames are whole."""
        return np.concatenate([part.done() for part in self._parts])

    def indices(self, split: str) -> NDArray[np.intp]:
        """Return the frames of a split that are done.

        Raises:
            InvalidValueError: If a data set has none.
        """
        starts = self._starts[:-1]
        return np.concatenate([start + part.indices(split) for start, part in zip(starts, self._parts, strict=True)])

    def verify(self, indices: Iterable[int]) -> None:
        """Compare frames with their checksums; see `DepthDataset`."""
        for index in indices:
            part, within = self._find(index)
            part.verify([within])

    def image(self, index: int) -> NDArray[np.uint8]:
        """Read one image (H, W)."""
        part, within = self._find(index)
        return part.image(within)

    def depth_mm(self, index: int) -> NDArray[np.float32]:
        """Read one exact depth map (H, W)."""
        part, within = self._find(index)
        return part.depth_mm(within)

    def lit(self, index: int) -> NDArray[np.bool_]:
        """Read where the projector reached (H, W)."""
        part, within = self._find(index)
        return part.lit(within)

    def rig(self, index: int) -> Rig:
        """Return the rig that took a frame."""
        part, within = self._find(index)
        return part.rig(within)

    def _find(self, index: int) -> tuple[DepthDataset, int]:
        part, within = self._place(index)
        return self._parts[part], within

    def _place(self, index: int) -> tuple[int, int]:
        if not 0 <= index < len(self):
            raise InvalidValueError("index of a frame", index, f"0 to {len(self) - 1}")
        part = int(np.searchsorted(self._starts, index, side="right")) - 1
        return part, int(index - self._starts[part])


class JoinedPairs(JoinedDataset):
    """The same of data sets that all have a reference camera."""

    def __init__(self, parts: Sequence[ReferencedDataset]) -> None:
        """Join open data sets; see `JoinedDataset`."""
        super().__init__(parts)
        self._pairs = tuple(parts)

    def reference_depth_mm(self, index: int) -> NDArray[np.float32]:
        """Read one depth map (H, W) of the reference camera."""
        part, within = self._place(index)
        return self._pairs[part].reference_depth_mm(within)


def join(parts: Sequence[DepthDataset]) -> DepthDataset:
    """Return several data sets as one, with reference depth if all have it; a single one as it is.

    Raises:
        InvalidValueError: If there is none, or they differ in the size of their images.
    """
    if len(parts) == 1:
        return parts[0]
    pairs = [part for part in parts if isinstance(part, ReferencedDataset)]
    return JoinedPairs(pairs) if len(pairs) == len(parts) else JoinedDataset(parts)
