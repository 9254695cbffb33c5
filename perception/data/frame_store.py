"""Data sets of stripe frames with exact depth, laid out on disk as in `store`.

| array | shape, type | what |
|---|---|---|
| `image` | (N, H, W) uint8 | grey values |
| `depth_mm` | (N, H, W) float32 | exact z-depth, NaN where nothing was hit |
| `lit` | (N, H, W) bool | the projector reaches the point |
| `scope` | (N,) int32 | index into the attribute `scopes`, those that took the frames |
| `family`, `texture` | (N,) int32 | index into the attributes `families` and `textures`: what the frames show |

Sets of the format before, `laploop-frames-3`, show the family `tissue` with its own texture.
"""

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from laploop.assets.anatomy.families.registry import TISSUE_FAMILY
from laploop.assets.anatomy.textures import OWN_TEXTURE
from laploop.assets.scope_optics import ScopeOptics
from laploop.configuration import from_plain, to_plain
from laploop.errors import InvalidValueError
from laploop.perception.data.store import Store
from laploop.perception.geometry import Rig


class FrameStore(Store):
    """One data set of frames on disk."""

    FORMAT = "laploop-frames-4"
    READABLE_FORMATS = ("laploop-frames-3",)
    OLDER_FORMATS = ("laploop-frames-1", "laploop-frames-2")
    COMMAND = "`laploop synthesize`"

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
        families: Sequence[str] = (TISSUE_FAMILY,),
        family: NDArray[np.int32] | None = None,
        textures: Sequence[str] = (OWN_TEXTURE,),
        texture: NDArray[np.int32] | None = None,
    ) -> "FrameStore":
        """Make an empty store for the planned frames at a path that does not exist yet; it appears whole or not at all.

        Args:
            path: The new folder.
            optics: The nominal scope.
            tissue_seed: Tissue of each frame, (N,).
            split: Split of each frame, an index into `SPLITS`.
            tool_in_view: Frames with the instrument in view.
            config: What the frames are made from, as JSON has it.
            scopes: Scopes that take the frames; `optics` alone by default.
            scope: Which of them takes each frame.
            families: Names of families of shapes.
            family: Which of them each frame shows; the first by default.
            textures: Names of kinds of texture.
            texture: Which of them each frame shows; the first by default.

        Raises:
            OutputError: If the path exists or cannot be written.
            InvalidValueError: If a frame's scope, family or texture is not among those given, or a scope has another size of
                image.
        """
        if scope is None and not scopes:
            scopes, scope = (optics,), np.zeros(len(split), dtype=np.int32)
        scope = _checked_index("scope", scope, len(scopes), len(split))
        _check_sizes(optics, scopes)
        first = np.zeros(len(split), dtype=np.int32)
        family = _checked_index("family", first if family is None else family, len(families), len(split))
        texture = _checked_index("texture", first if texture is None else texture, len(textures), len(split))
        size = (optics.height, optics.width)
        return cls._create(
            path,
            arrays={"image": ("uint8", size), "depth_mm": ("float32", size), "lit": ("bool", size)},
            plan={
                "tissue_seed": tissue_seed,
                "split": split,
                "tool_in_view": tool_in_view,
                "scope": scope,
                "family": family,
                "texture": texture,
            },
            optics=to_plain(optics),
            scopes=[to_plain(one) for one in scopes],
            config=dict(config),
            families=list(families),
            textures=list(textures),
        )

    def write(self, index: int, *, image: NDArray[np.uint8], depth_mm: NDArray[np.float32], lit: NDArray[np.bool_]) -> None:
        """Write one frame, which is done when this returns.

        Raises:
            InvalidValueError: If there is no such frame, or an array has another type or shape.
            OutputError: If the disk refuses.
        """
        self._write(index, {"image": image, "depth_mm": depth_mm, "lit": lit})

    def rig(self, index: int) -> Rig:
        """Return the rig that took a frame; see `DepthDataset`."""
        self._check_index(index)
        rig: Rig = self._rigs[self._plan["scope"][index]]
        return rig

    def family(self, index: int) -> str:
        """Return the family of shapes that a frame shows; see `DepthDataset`."""
        return self._named("family", "families", index) or super().family(index)

    def texture(self, index: int) -> str:
        """Return the kind of texture that a frame shows; see `DepthDataset`."""
        return self._named("texture", "textures", index) or super().texture(index)

    def shown(self) -> tuple[frozenset[str], frozenset[str]]:
        """Return the families and the textures of all frames; see `DepthDataset`."""
        if "families" not in self._attributes:
            return super().shown()
        return frozenset(self._attributes["families"]), frozenset(self._attributes["textures"])

    def tissues_by_family(self) -> dict[str, int]:
        """Return the number of tissues, or scenes, of each family."""
        names = np.array([self.family(index) for index in range(len(self))])
        return {str(name): len(np.unique(self.tissue_seed[names == name])) for name in np.unique(names)}

    def _named(self, plan: str, names: str, index: int) -> str | None:
        """Return the name that a plan gives to a frame; None in a set of the format before, which has no such plan."""
        self._check_index(index)
        return str(self._attributes[names][self._plan[plan][index]]) if plan in self._plan else None

    @cached_property
    def _rigs(self) -> list[Rig]:
        """The rigs of all scopes."""
        return [Rig.from_optics(from_plain(ScopeOptics, values)) for values in self._attributes["scopes"]]


def _checked_index(name: str, index: NDArray[np.int32] | None, count: int, frames: int) -> NDArray[np.int32]:
    if index is None or index.shape != (frames,) or frames == 0 or index.min() < 0 or index.max() >= count:
        found = None if index is None else index.shape
        raise InvalidValueError(name, found, f"one index a frame ({frames}), each from 0 to {count - 1}")
    return index


def _check_sizes(optics: ScopeOptics, scopes: Sequence[ScopeOptics]) -> None:
    for one in scopes:
        if (one.width, one.height) != (optics.width, optics.height):
            raise InvalidValueError("size of a scope's image", (one.width, one.height), f"{(optics.width, optics.height)}")
