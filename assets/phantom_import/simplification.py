"""A surface with fewer triangles, and how far it lies from the one given.

fast-simplification (MIT) joins edges by their quadric error (Garland, Heckbert: Surface simplification using quadric error
metrics, SIGGRAPH 1997). Asked for a twentieth of the triangles at once it folds and tears rough surfaces; asked for half of
them again and again it does not.
"""

from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from trimesh import remesh
from trimesh.triangles import closest_point

from laploop.arrays import Array

_AGGRESSION = 5
"""How fast its threshold rises, of 10; with less it stops before it has joined enough."""
_PIECE_MM = 1.0
"""Longest edges of the pieces into which a surface is cut to measure distances from it."""
_NEAR = 24
"""Pieces that are tried as the nearest of a point."""
_AT_ONCE = 10_000


def with_fewer_triangles(surface: Any, count: int) -> Any:
    """Return a trimesh surface with at most `count` triangles; with more, where no more can be joined."""
    while len(surface.faces) > count:
        goal = max(count, len(surface.faces) // 2)
        simpler = surface.simplify_quadric_decimation(face_count=goal, aggression=_AGGRESSION)
        if len(simpler.faces) > (goal + len(surface.faces)) // 2:
            break
        surface = simpler
    return surface


def deviation(one: Any, other: Any) -> float:
    """Return the largest distance of two trimesh surfaces from each other in mm, by vertices and middles of triangles."""
    return max(_farthest(one, other), _farthest(other, one))


def _farthest(surface: Any, other: Any) -> float:
    """Return how far the farthest point of a surface is from another one."""
    vertices, faces = remesh.subdivide_to_size(other.vertices, other.faces, _PIECE_MM)  # type: ignore[no-untyped-call]
    corners = vertices[faces]
    tree = cKDTree(corners.mean(axis=1))
    points = np.concatenate([surface.vertices, surface.triangles_center])
    # The piece with the nearest middle gives a bound. Behind the points that are farthest by it, few need a closer look.
    bound = _distances(points, corners, tree, 1)
    order = np.argsort(-bound)
    farthest = 0.0
    for begin in range(0, len(order), _AT_ONCE):
        part = order[begin : begin + _AT_ONCE]
        if bound[part[0]] <= farthest:
            break
        farthest = max(farthest, float(_distances(points[part], corners, tree, min(_NEAR, len(corners))).max()))
    return farthest


def _distances(points: Array, corners: Array, tree: Any, count: int) -> Array:
    """Return the distances of points (n, 3) from the nearest of those `count` triangles whose middles are nearest, (n,)."""
    near = corners[tree.query(points, k=count)[1].ravel()]
    found = closest_point(near, np.repeat(points, count, axis=0)).reshape(-1, count, 3)  # type: ignore[no-untyped-call]
    return np.asarray(np.linalg.norm(found - points[:, None], axis=2).min(axis=1))
