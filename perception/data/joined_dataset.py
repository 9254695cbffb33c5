"""Several data sets as one, for training on all of them."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from laploop.errors import InvalidValueError
from laploop.perception.data.dataset import DepthDataset, ReferencedDataset
from laploop.perception.geometry import Rig


class JoinedDataset(DepthDataset):
    """The frames of several data sets, one set after another; each keeps its splits."""

    def __init__(self, parts: Sequence[DepthDataset]) -> None:
        """Join open data sets with images of one size."""
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
        self.optics = parts[0].optics
        self.has_exact = all(part.has_exact for part in parts)
        self.split = np.concatenate([part.split for part in parts])
        self.tissue_seed = np.concatenate([part.tissue_seed for part in parts])
        self.tool_in_view = np.concatenate([part.tool_in_view for part in parts])

    def done(self) -> NDArray[np.bool_]:
        """Return which frames are whole."""
        return np.concatenate([part.done() for part in self._parts])

    def read(self, name: str, index: int) -> NDArray[Any]:
        """Read one array of a frame; see `DepthDataset`."""
        part, within = self._find(index)
        return part.read(name, within)

    def verify(self, indices: Iterable[int]) -> None:
        """Compare frames with their checksums; see `DepthDataset`."""
        for index in indices:
            part, within = self._find(index)
            part.verify([within])

    def rig(self, index: int) -> Rig:
        """Return the rig that took a frame."""
        part, within = self._find(index)
        return part.rig(within)

    def family(self, index: int) -> str:
        """Return the family of shapes that a frame shows."""
        part, within = self._find(index)
        return part.family(within)

    def texture(self, index: int) -> str:
        """Return the kind of texture that a frame shows."""
        part, within = self._find(index)
        return part.texture(within)

    def shown(self) -> tuple[frozenset[str], frozenset[str]]:
        """Return the families and the textures of all frames."""
        families, textures = zip(*(part.shown() for part in self._parts), strict=True)
        return frozenset().union(*families), frozenset().union(*textures)

    def _find(self, index: int) -> tuple[DepthDataset, int]:
        self._check_index(index)
        part = int(np.searchsorted(self._starts, index, side="right")) - 1
        return self._parts[part], int(index - self._starts[part])


class JoinedPairs(JoinedDataset, ReferencedDataset):
    """The same of data sets that all have a reference camera."""


def join(parts: Sequence[DepthDataset]) -> DepthDataset:
    """Return several data sets as one, with reference depth if all have it; a single one as it is.

    Raises:
        InvalidValueError: If there is none, or they differ in the size of their images.
    """
    if len(parts) == 1:
        return parts[0]
    return JoinedPairs(parts) if all(isinstance(part, ReferencedDataset) for part in parts) else JoinedDataset(parts)
