"""A material point of the tissue's surface, followed as the tissue deforms."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from laploop.arrays import Array
from laploop.errors import InvalidValueError

IndexArray = NDArray[np.signedinteger[Any]]


class SurfacePoint:
    """A point given by a triangle and its barycentric coordinates, with the smooth normal of the surface there."""

    def __init__(self, triangles: IndexArray, face: int, weights: Array) -> None:
        """Remember the triangle and the triangles around its corners.

        Args:
            triangles: (m, 3), corners of the surface's triangles, outward by the right-hand rule.
            face: Index of the triangle that holds the point.
            weights: (3,), barycentric coordinates, which add up to 1.
        """
        self._corners = triangles[face]
        self._weights = weights
        touching = np.isin(triangles, self._corners)
        self._neighbours = triangles[touching.any(axis=1)]
        # (neighbour, corner): which of the point's three corners each neighbouring triangle touches.
        self._incidence = (self._neighbours[:, :, None] == self._corners).any(axis=1).astype(np.float64)

    @classmethod
    def from_ray(cls, points: Array, triangles: IndexArray, origin: Array, direction: Array) -> "SurfacePoint":
        """Find where a ray first meets the surface (Moeller and Trumbore, J Graph Tools 1997;2:21).

        Args:
            points: (n, 3), vertices.
            triangles: (m, 3), indices into them.
            origin: (3,), start of the ray, in the vertices' frame.
            direction: (3,), of any length.

        Raises:
            InvalidValueError: If the ray misses the surface.
        """
        first = points[triangles[:, 0]]
        edge_1 = points[triangles[:, 1]] - first
        edge_2 = points[triangles[:, 2]] - first
        p = np.cross(direction, edge_2)
        determinant = np.einsum("ij,ij->i", edge_1, p)
        with np.errstate(divide="ignore", invalid="ignore"):
            s = origin - first
            u = np.einsum("ij,ij->i", s, p) / determinant
            q = np.cross(s, edge_1)
            v = q @ direction / determinant
            distance = np.einsum("ij,ij->i", edge_2, q) / determinant
            hit = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (distance > 0.0)
        if not hit.any():
            raise InvalidValueError("ray direction", direction.tolist(), "one that meets the tissue")
        face = int(np.argmin(np.where(hit, distance, np.inf)))
        return cls(triangles, face, np.array([1.0 - u[face] - v[face], u[face], v[face]]))

    def position(self, points: Array) -> Array:
        """Return where the point is now, (3,), given the vertices (n, 3)."""
        position: Array = self._weights @ points[self._corners]
        return position

    def normal(self, points: Array) -> Array:
        """Return the unit normal (3,): the corners' area-weighted normals, interpolated."""
        a, b, c = (points[self._neighbours[:, corner]] for corner in range(3))
        doubled_areas = np.cross(b - a, c - a)
        corner_normals = self._incidence.T @ doubled_areas
        corner_normals /= np.linalg.norm(corner_normals, axis=1, keepdims=True)
        normal: Array = self._weights @ corner_normals
        return normal / np.linalg.norm(normal)
