"""Whether a triangle mesh intersects itself: a sweep along x finds candidates, separating axes decide."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from laploop.arrays import Array

Pairs = NDArray[np.intp]

_PAIRS_AT_ONCE = 2_000_000
_SHRINK = 0.01
"""Fraction by which shared corners of two triangles move towards the centroid of each, so that neighbours meet only where
they fold onto each other or cross."""
_DEGENERATE = 1e-6
"""Sine of the angle below which two directions count as parallel."""


def crossing_triangles(points: Array, triangles: NDArray[np.integer], *, tolerance: float) -> tuple[int, int] | None:
    """Return the rows of two triangles that cross or overlap in one plane, or None.

    Triangles that merely touch do not cross. Those thinner than the tolerance are skipped: they enclose nothing.

    Args:
        points: (n, 3).
        triangles: (m, 3), rows of `points`; neighbours share their corners.
        tolerance: Depth, in the unit of the points, from which overlapping triangles count.
    """
    rows = _proper(points[triangles], tolerance)
    corners = points[triangles[rows]]
    for first, second in _candidates(corners):
        one, two = _apart(corners, triangles[rows], first, second)
        crossing = np.flatnonzero(_cross(one, two, tolerance))
        if crossing.size:
            pair = crossing[0]
            return int(rows[first[pair]]), int(rows[second[pair]])
    return None


def _proper(corners: Array, tolerance: float) -> Pairs:
    """Return the rows of the triangles (m, 3, 3) whose smallest altitude exceeds the tolerance."""
    edges = np.roll(corners, -1, axis=1) - corners
    twice_area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    return np.flatnonzero(twice_area > tolerance * np.linalg.norm(edges, axis=2).max(axis=1, initial=0.0))


def _candidates(corners: Array) -> Iterator[tuple[Pairs, Pairs]]:
    """Yield batches of all pairs of triangles (m, 3, 3) whose boxes overlap."""
    low, high = corners.min(axis=1), corners.max(axis=1)
    order = np.argsort(low[:, 0], kind="stable")
    counts = np.searchsorted(low[order, 0], high[order, 0], side="right") - np.arange(len(order)) - 1
    begin = 0
    while begin < len(order):
        total = np.cumsum(counts[begin:])
        end = begin + max(1, int(np.searchsorted(total, _PAIRS_AT_ONCE, side="right")))
        chunk = counts[begin:end]
        place = np.repeat(np.arange(begin, end), chunk)
        step = np.arange(place.size) - np.repeat(np.cumsum(chunk) - chunk, chunk)
        first, second = order[place], order[place + 1 + step]
        near = np.all((low[first, 1:] <= high[second, 1:]) & (low[second, 1:] <= high[first, 1:]), axis=1)
        yield first[near], second[near]
        begin = end


def _apart(corners: Array, triangles: NDArray[np.integer], first: Pairs, second: Pairs) -> tuple[Array, Array]:
    """Return the corners of both triangles of each pair, (k, 3, 3), shared ones moved towards each centroid."""
    same = triangles[first][:, :, None] == triangles[second][:, None, :]
    result = []
    for rows, common in ((first, same.any(axis=2)), (second, same.any(axis=1))):
        own = corners[rows]
        middle = own.mean(axis=1, keepdims=True)
        result.append(np.where(common[:, :, None], own + _SHRINK * (middle - own), own))
    return result[0], result[1]


def _cross(one: Array, two: Array, tolerance: float) -> NDArray[np.bool_]:
    """Tell for each pair of triangles (k, 3, 3) whether no axis separates them.

    Two convex sets are apart if and only if an axis separates their shadows; for triangles, the normals, the products of
    edges, and, in one plane, the normals of the edges are enough.
    """
    edges = [np.roll(corners, -1, axis=1) - corners for corners in (one, two)]
    edges = [edge / np.linalg.norm(edge, axis=2, keepdims=True) for edge in edges]
    normals = [np.cross(edge[:, 0], edge[:, 1]) for edge in edges]
    normals = [normal / np.linalg.norm(normal, axis=1, keepdims=True) for normal in normals]
    coplanar = np.ones(len(one), dtype=np.bool_)
    for normal, own, other in ((normals[0], one, two), (normals[1], two, one)):
        heights = np.einsum("ki,kji->kj", normal, other - own[:, :1])
        coplanar &= np.abs(heights).max(axis=1, initial=0.0) < tolerance
    crossing = np.ones(len(one), dtype=np.bool_)
    for edge, normal in zip(edges, normals, strict=True):
        crossing &= coplanar | (_penetration(normal, one, two) > tolerance)
        for k in range(3):
            crossing &= _penetration(np.cross(normal, edge[:, k]), one, two) > tolerance
    for i in range(3):
        for j in range(3):
            axis = np.cross(edges[0][:, i], edges[1][:, j])
            length = np.linalg.norm(axis, axis=1, keepdims=True)
            useless = coplanar | (length[:, 0] < _DEGENERATE)
            crossing &= useless | (_penetration(axis / np.maximum(length, _DEGENERATE), one, two) > tolerance)
    return crossing


def _penetration(axis: Array, one: Array, two: Array) -> Array:
    """Return how far the second triangle would have to move along the axis to be clear of the first; negative: the gap."""
    # From a corner of the first: differences of nearby points keep their digits.
    a = np.einsum("ki,kji->kj", axis, one - one[:, :1])
    b = np.einsum("ki,kji->kj", axis, two - one[:, :1])
    return np.asarray(np.minimum(a.max(axis=1) - b.min(axis=1), b.max(axis=1) - a.min(axis=1)))
