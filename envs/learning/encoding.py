"""From measured quantities to what a network takes: scaled vectors and images of 8 bits.

All functions take any number of leading dimensions, so that many environments are encoded at once.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from laploop.arrays import Array
from laploop.perception.working_range import WORKING_RANGE_MM

BOUND = 5.0
"""Scaled quantities are clipped to this size. They are about 1; a tip that is far away is not much more."""
DEPTH_NEAR_MM = WORKING_RANGE_MM[0] - 20.0
"""Depth that the grey value 1 stands for. The tool comes nearer to the camera than the tissue does."""
DEPTH_FAR_MM = WORKING_RANGE_MM[1] + 20.0
"""Depth that the grey value 255 stands for."""
_LEVELS = 254


@dataclass(frozen=True)
class Scale:
    """How a quantity is scaled: `(value - offset) / scale`, in its own unit."""

    scale: float = 1.0
    offset: tuple[float, ...] = (0.0,)

    @classmethod
    def of_bounds(cls, low: float, high: float) -> "Scale":
        """Return the scale that takes bounds to -1 and 1."""
        return cls(0.5 * (high - low), (0.5 * (high + low),))


SCALES: Mapping[str, Scale] = {
    "tip_position": Scale(0.05, (0.0, 0.0, 0.09)),
    "tip_velocity": Scale(0.06),
    "contact_force": Scale(2.0),
    "frame_age": Scale(0.1),
    "scope_velocity": Scale(0.06),
    "scope_insertion": Scale(0.05, (0.11,)),
    "to_target": Scale(0.02),
    "target_normal": Scale(),
    "tissue_velocity": Scale(0.06),
    "true_force": Scale(2.0),
    "target_distance": Scale(0.02),
}
"""By entry, in SI units: half the width of the view at its middle, about 0.09 m away; the largest commanded speed; the force
from which pressing is punished; 2.5 camera periods; the length of the last approach. Other entries go from the bounds of their
space to -1 and 1."""


@dataclass(frozen=True)
class Entry:
    """A named part of a vector."""

    name: str
    size: int
    scale: Scale


@dataclass(frozen=True)
class VectorLayout:
    """Which entries a vector has, in which order, and how each is scaled."""

    entries: tuple[Entry, ...]

    @classmethod
    def of(cls, sizes: Mapping[str, int], bounded: Mapping[str, spaces.Box]) -> "VectorLayout":
        """Make the layout of entries with a scale of their own, by name and size, and of others with the space they lie in."""
        known = [Entry(name, size, SCALES[name]) for name, size in sizes.items()]
        others = [
            Entry(name, math.prod(box.shape), SCALES.get(name) or Scale.of_bounds(float(box.low.min()), float(box.high.max())))
            for name, box in bounded.items()
        ]
        return cls((*known, *others))

    def __add__(self, other: "VectorLayout") -> "VectorLayout":
        return VectorLayout((*self.entries, *other.entries))

    @cached_property
    def slices(self) -> dict[str, slice]:
        """Where each entry is, by name."""
        ends = np.cumsum([entry.size for entry in self.entries]).tolist()
        return {entry.name: slice(end - entry.size, end) for entry, end in zip(self.entries, ends, strict=True)}

    @property
    def size(self) -> int:
        """Length of the vector."""
        return sum(entry.size for entry in self.entries)

    def space(self) -> spaces.Box:
        """Return the space of the vector."""
        return spaces.Box(-BOUND, BOUND, (self.size,), np.float32)

    def encode(self, quantities: Mapping[str, ArrayLike]) -> NDArray[np.float32]:
        """Return the vector, (..., size), of quantities (..., entry size) in their own units."""
        parts = [
            np.clip((np.asarray(quantities[entry.name]) - entry.scale.offset) / entry.scale.scale, -BOUND, BOUND)
            for entry in self.entries
        ]
        return np.concatenate(parts, axis=-1, dtype=np.float32)

    def decode(self, vector: NDArray[Any]) -> dict[str, Array]:
        """Return the quantities, (..., entry size) in their own units, of a vector, (..., size); what was clipped stays so."""
        return {
            entry.name: vector[..., self.slices[entry.name]].astype(np.float64) * entry.scale.scale + entry.scale.offset
            for entry in self.entries
        }


def encode_depth(depth_mm: NDArray[np.floating[Any]], valid: NDArray[Any]) -> NDArray[np.uint8]:
    """Return depth maps, (..., height, width), as images (..., height, width, 1) of 8 bits.

    0 where depth is not valid; otherwise 1 at `DEPTH_NEAR_MM` and below to 255 at `DEPTH_FAR_MM` and beyond, 0.47 mm a level.
    """
    share = (np.clip(depth_mm, DEPTH_NEAR_MM, DEPTH_FAR_MM) - DEPTH_NEAR_MM) / (DEPTH_FAR_MM - DEPTH_NEAR_MM)
    levels = np.where(valid, 1.0 + np.round(_LEVELS * share), 0.0).astype(np.uint8)
    return np.asarray(levels[..., None])


def decode_depth(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the depth in millimetres, (..., height, width), of images (..., height, width, 1); NaN where it is not valid."""
    levels = image[..., 0].astype(np.float32)
    depth_mm = DEPTH_NEAR_MM + (levels - 1.0) * ((DEPTH_FAR_MM - DEPTH_NEAR_MM) / _LEVELS)
    return np.where(levels == 0.0, np.nan, depth_mm).astype(np.float32)


def encode_stripes(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a copy of grey values, (..., height, width), as images (..., height, width, 1)."""
    return image[..., None].copy()
