"""Solids as signed distances on a regular grid, from which a closed surface is cut.

Spheres and tubes are stamped into their surroundings alone, so that a body of a thousand of them takes tenths of a second.
scikit-image (BSD-3, extra `mesh`) cuts the surface by marching cubes in Lewiner's form (J. Graphics Tools 8(2), 2003), which
leaves no holes.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from laploop.arrays import Array, Float32
from laploop.assets.anatomy.anatomy_mesh import AnatomyMesh
from laploop.errors import InvalidValueError

SPACING_M = 7e-4
"""Distance of the grid's points: edges of triangles are half a millimetre to one."""
_FAR_M = 1.0
_BAND = 3.0
"""Distances are exact up to so many spacings around the surface, and cut off beyond."""

Box = tuple[slice, slice, slice]


class DistanceGrid:
    """Distances to the surface of a solid, negative inside; what reaches beyond the grid is cut off flat."""

    def __init__(self, low: ArrayLike, high: ArrayLike, spacing_m: float = SPACING_M) -> None:
        """Make an empty grid from one corner (3,) to the other, metres."""
        self.spacing_m = spacing_m
        self.low = np.asarray(low, dtype=np.float64)
        counts = np.ceil((np.asarray(high) - self.low) / spacing_m).astype(int) + 1
        self.axes = [(self.low[k] + spacing_m * np.arange(counts[k])).astype(np.float32) for k in range(3)]
        self.values: Float32 = np.full(tuple(counts), _FAR_M, dtype=np.float32)

    @classmethod
    def around(cls, points: Array, margin_m: float, spacing_m: float = SPACING_M) -> "DistanceGrid":
        """Make a grid that holds points (k, 3) and a margin."""
        return cls(points.min(axis=0) - margin_m, points.max(axis=0) + margin_m, spacing_m)

    @property
    def coordinates(self) -> tuple[Float32, Float32, Float32]:
        """x, y, z of the grid's points, to be broadcast: (nx, 1, 1), (1, ny, 1), (1, 1, nz)."""
        x, y, z = self.axes
        return x[:, None, None], y[None, :, None], z[None, None, :]

    def unite(self, distances: Float32, blend_m: float = 0.0) -> None:
        """Add a solid by its distances everywhere; creases are rounded over `blend_m` by a polynomial smooth minimum."""
        _unite(self.values, distances, blend_m)

    def carve(self, distances: Float32, blend_m: float = 0.0) -> None:
        """Take a solid away."""
        self.values *= -1.0
        _unite(self.values, distances, blend_m)
        self.values *= -1.0

    def add_spheres(self, centres: Array, radii: Array, blend_m: float = 0.0) -> None:
        """Add spheres one after another, centres (k, 3), radii (k,)."""
        for centre, radius in zip(centres, radii, strict=True):
            box = self._box(centre, radius + blend_m)
            if self.values[box].size:
                _unite(self.values[box], self._sphere(box, centre, radius), blend_m)

    def add_tube(self, path: Array, radii: Array | float, blend_m: float = 0.0) -> None:
        """Add the union of spheres along a path (k, 3); only the tube as a whole is blended with what is there."""
        self.unite(self.tube(path, radii, blend_m), blend_m)

    def tube(self, path: Array, radii: Array | float, reach_m: float = 0.0) -> Float32:
        """Return the distances from a tube, right up to `reach_m` from its surface."""
        tube: Float32 = np.full_like(self.values, _FAR_M)
        for centre, radius in zip(path, np.broadcast_to(radii, len(path)), strict=True):
            box = self._box(centre, radius + reach_m)
            if tube[box].size:
                np.minimum(tube[box], self._sphere(box, centre, radius), out=tube[box])
        return tube

    def smooth(self, width: float) -> None:
        """Round creases and edges by a Gaussian whose standard deviation is `width` spacings."""
        reach = _BAND * self.spacing_m
        self.values = ndimage.gaussian_filter(np.clip(self.values, -reach, reach), width, mode="nearest")

    def keep_one_body(self) -> None:
        """Fill closed hollows and remove all but the largest body."""
        inside = ndimage.binary_fill_holes(self.values < 0.0)
        labels, count = ndimage.label(inside)
        sizes = np.bincount(labels.ravel(), minlength=count + 1)
        largest = labels == 1 + int(np.argmax(sizes[1:]))
        self.values[inside & ~largest] = self.spacing_m
        self.values[largest & (self.values >= 0.0)] = -self.spacing_m

    def surface(self, *, smoothing: float = 0.7) -> AnatomyMesh:
        """Cut the closed surface after `smooth`.

        Raises:
            InvalidValueError: If scikit-image is not installed.
        """
        self.smooth(smoothing)
        # A border outside closes what the grid cuts off.
        values = np.pad(self.values, 1, constant_values=self.spacing_m)
        # A surface right through a point of the grid would have triangles without area.
        values[np.abs(values) < 1e-3 * self.spacing_m] = 1e-3 * self.spacing_m
        points, triangles = _marching_cubes(values)
        return AnatomyMesh(
            points=(points - 1.0) * self.spacing_m + self.low,
            triangles=triangles,
            parts=np.zeros(len(triangles), dtype=np.int32),
        )

    def _box(self, centre: Array, reach_m: float) -> Box:
        """Return the grid's points around a centre."""
        reach = reach_m + (_BAND + 1.0) * self.spacing_m
        first = np.maximum(np.ceil((centre - reach - self.low) / self.spacing_m), 0).astype(int)
        last = np.maximum(np.floor((centre + reach - self.low) / self.spacing_m), -1).astype(int)
        x, y, z = (slice(int(a), int(b) + 1) for a, b in zip(first, last, strict=True))
        return x, y, z

    def _sphere(self, box: Box, centre: Array, radius: float) -> Float32:
        squares = [(axis[part] - np.float32(c)) ** 2 for axis, part, c in zip(self.axes, box, centre, strict=True)]
        distance = squares[0][:, None, None] + (squares[1][:, None] + squares[2][None, :])
        np.sqrt(distance, out=distance)
        distance -= np.float32(radius)
        return np.asarray(distance)


def rounded_box(grid: DistanceGrid, centre: Sequence[float], half: Sequence[float], radius: float) -> Float32:
    """Return the distances from a box with the half sizes `half` and edges rounded by `radius`, on the points of a grid."""
    apart = [np.abs(x - np.float32(c)) - np.float32(h - radius) for x, c, h in zip(grid.coordinates, centre, half, strict=True)]
    outside = np.sqrt(sum(np.maximum(a, 0.0) ** 2 for a in apart))
    inside = np.minimum(np.maximum(np.maximum(apart[0], apart[1]), apart[2]), 0.0)
    return np.asarray(outside + inside - np.float32(radius), dtype=np.float32)


def _unite(values: Float32, other: Float32, blend_m: float) -> None:
    if blend_m <= 0.0:
        np.minimum(values, other, out=values)
        return
    near = np.float32(blend_m) - np.abs(values - other)
    np.maximum(near, 0.0, out=near)
    np.minimum(values, other, out=values)
    near *= near
    near *= np.float32(0.25 / blend_m)
    values -= near


def require_scikit_image() -> None:
    """Check that surfaces can be cut.

    Raises:
        InvalidValueError: If scikit-image is not installed.
    """
    try:
        import skimage.measure  # noqa: F401
    except ImportError as error:
        raise InvalidValueError(
            "anatomy", "procedural", f"none, as package {error.name!r} is missing; install it with: pip install 'laploop[mesh]'"
        ) from error


def _marching_cubes(values: Float32) -> tuple[Array, NDArray[np.int32]]:
    """Return the surface where the values are 0, in grid spacings, anticlockwise from where they are positive."""
    require_scikit_image()
    from skimage.measure import marching_cubes

    points, triangles, _, _ = marching_cubes(values, 0.0, gradient_direction="descent")  # type: ignore[no-untyped-call]
    return points.astype(np.float64), triangles.astype(np.int32)
