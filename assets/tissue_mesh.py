"""A phantom's solid: tetrahedra below a height field, or those that fill a user's own surface."""

from dataclasses import dataclass

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
    """(n, 3), metres, layer by layer from the bottom; within a layer, y runs fastest."""
    tetrahedra: NDArray[np.int32]
    """(m, 4), positively oriented."""
    surface_vertices: NDArray[np.int32]
    """(k,), indices into `points` of the vertices on the top and the sides; those of the top come first."""
    triangles: NDArray[np.int32]
    """(t, 3), indices into `surface_vertices`, anticlockwise when seen from outside; those of the top come first."""
    top_triangle_count: int
    fills_box: bool
    """Whether the solid extends through the whole of its bounding box, so that no lattice cell is nearly empty."""


def solid_mesh(shape: TissueShape, height: Array) -> TissueMesh:
    """Fill the space between the plane z = 0 and the height field with columns of tetrahedra.

    Raises:
        InvalidValueError: If the height field is not (samples, samples), finite and positive.
    """
    n, layers = shape.samples, shape.layers
    if height.shape != (n, n) or not np.all(np.isfinite(height)) or height.min() <= 0.0:
        raise InvalidValueError("height field", height.shape, f"({n}, {n}) of finite positive heights")
    line = np.linspace(-0.5 * shape.side_m, 0.5 * shape.side_m, n)
    x, y = np.meshgrid(line, line, indexing="ij")
    points = np.stack([np.stack([x, y, height * (k / layers)], axis=-1).reshape(-1, 3) for k in range(layers + 1)]).reshape(
        -1, 3
    )
    index = np.arange(points.shape[0], dtype=np.int32).reshape(layers + 1, n, n)
    top = _split_quads(index[-1, :-1, :-1], index[-1, 1:, :-1], index[-1, 1:, 1:], index[-1, :-1, 1:])
    return _solid(points, _tetrahedra(index), top=top, sides=_side_quads(index), fills_box=True)


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
    corners = points[tetrahedra]
    turned = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0.0
    tetrahedra[turned] = tetrahedra[turned][:, [0, 2, 1, 3]]
    # Three corners of a positive tetrahedron are anticlockwise from outside in these orders.
    faces = np.concatenate([tetrahedra[:, order] for order in ([1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1])])
    _, first, uses = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    shell = faces[first[uses == 1]]
    normals = _normals(points[shell])
    underside = (normals[:, 2] < 0.0) & np.all(points[shell, 2] < _UNDERSIDE_M, axis=1)
    shell, normals = shell[~underside], normals[~underside]
    top = _seen_from_above(points[shell], normals)
    return _solid(points, tetrahedra, top=shell[top], sides=shell[~top], fills_box=False)


def mean_top_height(mesh: TissueMesh) -> float:
    """Return the mean height above the plate, in metres, of what is visible from straight above, weighted by plan area."""
    corners = mesh.points[mesh.surface_vertices][mesh.triangles[: mesh.top_triangle_count]]
    plan = _normals(corners)[:, 2]
    return float(np.sum(plan * corners[:, :, 2].mean(axis=1)) / plan.sum())


def _solid(points: Array, tetrahedra: Triangles, *, top: Triangles, sides: Triangles, fills_box: bool) -> TissueMesh:
    """Number the vertices of the surface; `top` and `sides` are triangles of rows of `points`."""
    top_vertices = np.unique(top)
    surface = np.concatenate([top_vertices, np.setdiff1d(sides, top_vertices)]).astype(np.int32)
    place = np.full(len(points), -1, dtype=np.int32)
    place[surface] = np.arange(surface.size, dtype=np.int32)
    triangles = place[np.concatenate([top, sides])]
    for array in (points, tetrahedra, surface, triangles):
        array.flags.writeable = False
    return TissueMesh(
        points=points,
        tetrahedra=tetrahedra,
        surface_vertices=surface,
        triangles=triangles,
        top_triangle_count=len(top),
        fills_box=fills_box,
    )


def _split_quads(a: Triangles, b: Triangles, c: Triangles, d: Triangles) -> Triangles:
    """Split quads a-b-c-d (anticlockwise from outside) into triangles along a-c."""
    quads = np.stack([a.ravel(), b.ravel(), c.ravel(), d.ravel()], axis=-1)
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)


def _side_quads(index: NDArray[np.int32]) -> Triangles:
    """Return the triangles of the four sides of a grid of vertex indices [layer, x, y]."""
    walls = (index[:, :, 0], index[:, -1, :], index[:, ::-1, -1], index[:, 0, ::-1])
    return np.concatenate([_split_quads(wall[:-1, :-1], wall[:-1, 1:], wall[1:, 1:], wall[1:, :-1]) for wall in walls])


def _tetrahedra(index: NDArray[np.int32]) -> NDArray[np.int32]:
    """Cut every cell of the grid [layer, x, y] into six tetrahedra around its main diagonal (Kuhn's triangulation)."""
    steps = {"x": (0, 1, 0), "y": (0, 0, 1), "z": (1, 0, 0)}
    shape = tuple(size - 1 for size in index.shape)

    def corner(offset: tuple[int, int, int]) -> NDArray[np.int32]:
        return index[tuple(slice(o, o + s) for o, s in zip(offset, shape, strict=True))].ravel()

    result = []
    for order in ("xyz", "yzx", "zxy", "xzy", "yxz", "zyx"):
        path = [(0, 0, 0)]
        for axis in order:
            path.append(tuple(p + s for p, s in zip(path[-1], steps[axis], strict=True)))  # type: ignore[arg-type]
        columns = [corner(offset) for offset in path]
        if order in {"xzy", "yxz", "zyx"}:
            columns[2], columns[3] = columns[3], columns[2]
        result.append(np.stack(columns, axis=-1))
    return np.concatenate(result).astype(np.int32)


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
