"""A phantom's solid: tetrahedra below a height field, or those that fill a user's own surface."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from laploop.arrays import Array
from laploop.assets.tissue_config import TissueShape
from laploop.errors import InvalidValueError

Triangles = NDArray[np.int32]

_UNDERSIDE_M = 0.001
"""Surface that looks down from less than this height lies on the plate."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TissueMesh:
    """A solid of tetrahedra and its visible surface, in the phantom's frame: origin below the middle, z up."""

    points: Array
    """(n, 3), metres: vertices of the solid."""
    tetrahedra: NDArray[np.int32]
    """(m, 4), rows of `points`, positively oriented."""
    surface_points: Array
    """(k, 3), metres: vertices of the top and the sides; those of the top come first."""
    triangles: NDArray[np.int32]
    """(t, 3), rows of `surface_points`, anticlockwise when seen from outside; those of the top come first."""
    top_triangle_count: int
    fills_box: bool
    """Whether the solid extends through the whole of its bounding box, so that no lattice cell is nearly empty."""


def solid_mesh(shape: TissueShape, height: Array, cells: tuple[int, int] = (10, 10)) -> TissueMesh:
    """Fill the space between the plane z = 0 and the height field with tetrahedra, as few as the top allows.

    The top keeps every sample, since it is what contact feels; the bottom, which lies on the plate, has a vertex only below
    each edge of a lattice cell. Every tetrahedron stays within one cell where the samples are a multiple of the cells: mass and
    stiffness of the lattice are then those of the finest mesh, to rounding.

    Args:
        shape: Side and samples.
        height: (samples, samples), metres above the plane, indexed [x, y].
        cells: Lattice cells along x and y.

    Raises:
        InvalidValueError: If the height field is not (samples, samples), finite and positive.
    """
    n = shape.samples
    if height.shape != (n, n) or not np.all(np.isfinite(height)) or height.min() <= 0.0:
        raise InvalidValueError("height field", height.shape, f"({n}, {n}) of finite positive heights")
    line = np.linspace(-0.5 * shape.side_m, 0.5 * shape.side_m, n)
    x, y = np.meshgrid(line, line, indexing="ij")
    top = np.stack([x, y, height], axis=-1).reshape(-1, 3)
    points, tetrahedra = _columns(shape, top, cells)
    floor = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    index = np.arange(2 * n * n, dtype=np.int32).reshape(2, n, n)
    return _solid(
        points,
        tetrahedra,
        np.concatenate([floor, top]),
        top=_grid_triangles(n) + n * n,
        sides=_side_quads(index),
        fills_box=True,
    )


def solid_from_tetrahedra(points: Array, tetrahedra: NDArray[np.int32]) -> TissueMesh:
    """Centre a solid on the plate and find its surface.

    The top is what is visible from straight above; the rest, apart from the underside on the plate, are the sides.

    Args:
        points: (n, 3), metres, z up, in any place.
        tetrahedra: (m, 4), of either orientation.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    points = points - np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), low[2]])
    tetrahedra = np.array(tetrahedra, dtype=np.int32)
    turned = _volumes(points, tetrahedra) < 0.0
    tetrahedra[turned] = tetrahedra[turned][:, [0, 2, 1, 3]]
    # Three corners of a positive tetrahedron are anticlockwise from outside in these orders.
    faces = np.concatenate([tetrahedra[:, order] for order in ([1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1])])
    _, first, uses = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    shell = faces[first[uses == 1]]
    normals = _normals(points[shell])
    underside = (normals[:, 2] < 0.0) & np.all(points[shell, 2] < _UNDERSIDE_M, axis=1)
    shell, normals = shell[~underside], normals[~underside]
    top = _seen_from_above(points[shell], normals)
    return _solid(points, tetrahedra, points, top=shell[top], sides=shell[~top], fills_box=False)


def mean_top_height(mesh: TissueMesh) -> float:
    """Return the mean height above the plate, in metres, of what is visible from straight above, weighted by plan area."""
    corners = mesh.surface_points[mesh.triangles[: mesh.top_triangle_count]]
    plan = _normals(corners)[:, 2]
    return float(np.sum(plan * corners[:, :, 2].mean(axis=1)) / plan.sum())


def _columns(shape: TissueShape, top: Array, cells: tuple[int, int]) -> tuple[Array, Triangles]:
    """Return vertices and tetrahedra between the bottom and the top, (samples^2, 3); finer below slopes that need it."""
    plan = _normals(top[_grid_triangles(shape.samples)])[:, 2]
    expected = float(np.sum(plan * top[_grid_triangles(shape.samples), 2].mean(axis=1)))
    for factor in range(1, shape.samples):
        below = tuple(min(factor * count, shape.samples - 1) for count in cells)
        grid = [np.linspace(-0.5 * shape.side_m, 0.5 * shape.side_m, count + 1) for count in below]
        x, y = np.meshgrid(*grid, indexing="ij")
        points = np.concatenate([np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3), top])
        tetrahedra = _column_tetrahedra(shape.samples, (below[0] + 1, below[1] + 1))
        volumes = _volumes(points, tetrahedra)
        # Below a slope so steep that its plane passes under the bottom's vertex, tetrahedra turn over.
        if volumes.min() > 0.0 and np.isclose(volumes.sum(), expected, rtol=1e-9, atol=0.0):
            break
    return points, tetrahedra


@lru_cache(maxsize=32)
def _column_tetrahedra(samples: int, below: tuple[int, int]) -> Triangles:
    """Join a grid of triangles, (samples, samples) vertices, to a coarser grid of `below` vertices under it.

    Every triangle is joined to the nearest vertex below. That leaves gaps where neighbours differ: an edge between two
    triangles is joined to both their vertices, a corner of three or more to all of theirs. Rows count the lower grid first.
    """
    triangles = _grid_triangles(samples)
    middles = np.stack(np.divmod(triangles, samples), axis=-1).mean(axis=1)
    nearest = np.round(middles / (samples - 1) * (np.array(below) - 1)).astype(np.int32)
    owner = nearest[:, 0] * below[1] + nearest[:, 1]
    offset = below[0] * below[1]
    under_triangles = np.column_stack([triangles[:, [0, 2, 1]] + offset, owner])

    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    owners = np.tile(owner, 3)
    # The two triangles of an edge pass it in opposite directions.
    forwards, backwards = edges[:, 0] * samples**2 + edges[:, 1], edges[:, 1] * samples**2 + edges[:, 0]
    _, one, other = np.intersect1d(forwards, backwards, return_indices=True)
    apart = owners[one] != owners[other]
    under_edges = np.column_stack([edges[one] + offset, owners[other], owners[one]])[apart & (forwards[one] < backwards[one])]

    under_corners = []
    pairs = np.unique(np.column_stack([triangles.ravel(), np.repeat(owner, 3)]), axis=0)
    corners, first, counts = np.unique(pairs[:, 0], return_index=True, return_counts=True)
    for corner, start, count in zip(corners, first, counts, strict=True):
        around = pairs[start : start + count, 1]
        places = np.stack(np.divmod(around, below[1]), axis=-1)
        off = places - places.mean(axis=0)
        ring = around[np.argsort(np.arctan2(off[:, 1], off[:, 0]))]
        under_corners += [[ring[0], ring[k], ring[k + 1], corner + offset] for k in range(1, count - 1)]
    found = np.concatenate([under_triangles, under_edges, np.array(under_corners, dtype=np.int64).reshape(-1, 4)])
    result = found.astype(np.int32)
    result.flags.writeable = False
    return result


def _solid(
    points: Array, tetrahedra: Triangles, vertices: Array, *, top: Triangles, sides: Triangles, fills_box: bool
) -> TissueMesh:
    """Number the vertices of the surface; `top` and `sides` are triangles of rows of `vertices`."""
    top_vertices = np.unique(top)
    rows = np.concatenate([top_vertices, np.setdiff1d(sides, top_vertices)])
    place = np.full(len(vertices), -1, dtype=np.int32)
    place[rows] = np.arange(rows.size, dtype=np.int32)
    surface, triangles = vertices[rows], place[np.concatenate([top, sides])]
    for array in (points, tetrahedra, surface, triangles):
        array.flags.writeable = False
    return TissueMesh(
        points=points,
        tetrahedra=tetrahedra,
        surface_points=surface,
        triangles=triangles,
        top_triangle_count=len(top),
        fills_box=fills_box,
    )


@lru_cache(maxsize=8)
def _grid_triangles(samples: int) -> Triangles:
    """Return the triangles of a grid of (samples, samples) vertices, anticlockwise when seen from above."""
    index = np.arange(samples**2, dtype=np.int32).reshape(samples, samples)
    triangles = _split_quads(index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
    triangles.flags.writeable = False
    return triangles


def _split_quads(a: Triangles, b: Triangles, c: Triangles, d: Triangles) -> Triangles:
    """Split quads a-b-c-d (anticlockwise from outside) into triangles along a-c."""
    quads = np.stack([a.ravel(), b.ravel(), c.ravel(), d.ravel()], axis=-1)
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)


def _side_quads(index: NDArray[np.int32]) -> Triangles:
    """Return the triangles of the four sides of a grid of vertex indices [layer, x, y]."""
    walls = (index[:, :, 0], index[:, -1, :], index[:, ::-1, -1], index[:, 0, ::-1])
    return np.concatenate([_split_quads(wall[:-1, :-1], wall[:-1, 1:], wall[1:, 1:], wall[1:, :-1]) for wall in walls])


def _volumes(points: Array, tetrahedra: Triangles) -> Array:
    """Return the volumes (m,) of tetrahedra; negative where they are turned inside out."""
    corners = points[tetrahedra]
    return np.asarray(np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6.0)


def _normals(corners: Array) -> Array:
    """Return the outward normals of triangles (m, 3, 3); their length is the triangle's area."""
    return np.asarray(0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))


def _seen_from_above(corners: Array, normals: Array) -> NDArray[np.bool_]:
    """Return which triangles (m, 3, 3) face up and have no other above their centroid, (m,)."""
    seen: NDArray[np.bool_] = normals[:, 2] > 1e-3 * np.linalg.norm(normals, axis=1)
    rows = np.flatnonzero(seen)
    middles = corners[rows].mean(axis=1)
    low, high = corners.min(axis=1), corners.max(axis=1)
    for k in rows:
        # Centroids in this triangle's box and below its highest point; then below its plane, inside its outline.
        near = rows[
            np.all((middles[:, :2] >= low[k, :2]) & (middles[:, :2] <= high[k, :2]), axis=1) & (middles[:, 2] < high[k, 2])
        ]
        near = near[near != k]
        if near.size == 0:
            continue
        point = corners[near].mean(axis=1)
        edges = np.roll(corners[k], -1, axis=0) - corners[k]
        offsets = point[:, None, :2] - corners[k, :, :2]
        inside = np.all(edges[:, 0] * offsets[..., 1] - edges[:, 1] * offsets[..., 0] > 0.0, axis=1)
        below = (point - corners[k, 0]) @ normals[k] < 0.0
        seen[near[inside & below]] = False
    return seen
