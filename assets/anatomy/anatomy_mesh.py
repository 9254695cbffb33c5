"""The surface of a piece of anatomy."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from laploop.arrays import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class AnatomyMesh:
    """Triangles, anticlockwise from outside; z up, towards the endoscope, metres."""

    points: Array
    """(n, 3)."""
    triangles: NDArray[np.int32]
    """(m, 3), rows of `points`."""
    parts: NDArray[np.int32]
    """(m,), the organ that a triangle belongs to, from 0 on."""


def joined(meshes: list[AnatomyMesh]) -> AnatomyMesh:
    """Return several meshes as one; the parts of a mesh follow those of the one before."""
    points = np.cumsum([0] + [len(mesh.points) for mesh in meshes[:-1]])
    parts = np.cumsum([0] + [int(mesh.parts.max()) + 1 for mesh in meshes[:-1]])
    return AnatomyMesh(
        points=np.concatenate([mesh.points for mesh in meshes]),
        triangles=np.concatenate([mesh.triangles + first for mesh, first in zip(meshes, points, strict=True)]).astype(np.int32),
        parts=np.concatenate([mesh.parts + first for mesh, first in zip(meshes, parts, strict=True)]).astype(np.int32),
    )


def vertex_normals(points: Array, triangles: NDArray[np.integer]) -> Array:
    """Return the unit normals at the vertices, (n, 3): those of the triangles around each, weighted by area."""
    corners = points[triangles]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    count = len(points)
    total = np.stack([sum(np.bincount(triangles[:, k], area[:, axis], count) for k in range(3)) for axis in range(3)], axis=1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.asarray(total / np.maximum(length, 1e-20))
