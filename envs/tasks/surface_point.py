"""Material points and lines of the tissue's surface, followed as the tissue deforms."""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from laploop.arrays import Array
from laploop.errors import InvalidValueError

IndexArray = NDArray[np.signedinteger[Any]]


class Points(Protocol):
    """Vertices of the surface, an array (n, 3) or what gives rows of one, as `laploop.envs.theatre.tissue.Tissue` does."""

    def __getitem__(self, rows: IndexArray, /) -> Array:
        """Return the vertices of these rows, (*rows.shape, 3)."""
        ...


class SurfacePoint:
    """A point given by a triangle and its barycentric coordinates, with the smooth normal of the surface there."""

    def __init__(self, triangles: IndexArray, face: int, weights: Array) -> None:
        """Take a row of the surface's triangles, (m, 3), outward by the right-hand rule, and coordinates in it, (3,)."""
        self._corners = triangles[face]
        self._weights = weights
        neighbours = triangles[np.isin(triangles, self._corners).any(axis=1)]
        self._around, self._neighbours = np.unique(neighbours, return_inverse=True)
        self._neighbours = self._neighbours.reshape(neighbours.shape)
        # (neighbour, corner): which of the point's three corners each neighbouring triangle touches.
        self._incidence = (neighbours[:, :, None] == self._corners).any(axis=1).astype(np.float64)

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

    def position(self, points: Points) -> Array:
        """Return where the point is now, (3,), given the vertices."""
        position: Array = self._weights @ points[self._corners]
        return position

    def normal(self, points: Points) -> Array:
        """Return the unit normal (3,): the corners' area-weighted normals, interpolated."""
        a, b, c = points[self._around][self._neighbours.T]
        doubled_areas = np.cross(b - a, c - a)
        corner_normals = self._incidence.T @ doubled_areas
        corner_normals /= np.linalg.norm(corner_normals, axis=1, keepdims=True)
        normal: Array = self._weights @ corner_normals
        return normal / np.linalg.norm(normal)


@dataclass(frozen=True, kw_only=True, eq=False)
class PathFoot:
    """The point of a path that is nearest to another point."""

    along_m: float
    """Length of the path from its start to there, as it was when the path was drawn."""
    position: Array
    """(3,)."""
    normal: Array
    """(3,), unit normal of the surface there."""


class SurfacePath:
    """A polyline through material points of the surface."""

    def __init__(self, vertices: list[SurfacePoint], points: Array) -> None:
        """Take the polyline's vertices, and the surface's vertices (n, 3) as they are when it is drawn.

        Raises:
            InvalidValueError: If there are fewer than two vertices, or two neighbours are the same point.
        """
        if len(vertices) < 2:
            raise InvalidValueError("number of points of the path", len(vertices), "2 or more")
        self._vertices = vertices
        steps = np.linalg.norm(np.diff(self.positions(points), axis=0), axis=1)
        if not np.all(steps > 0.0):
            raise InvalidValueError("length of a path's steps in metres", steps.min(), "above 0")
        self._along = np.concatenate([[0.0], np.cumsum(steps)])

    @classmethod
    def from_rays(cls, points: Array, triangles: IndexArray, origin: Array, directions: Array) -> "SurfacePath":
        """Draw a path through the points where rays, (k, 3) from one origin, meet the surface; see `SurfacePoint.from_ray`."""
        return cls([SurfacePoint.from_ray(points, triangles, origin, direction) for direction in directions], points)

    @property
    def length_m(self) -> float:
        """Length of the path when it was drawn."""
        return float(self._along[-1])

    def positions(self, points: Array) -> Array:
        """Return where the polyline's vertices are now, (k, 3), given the surface's vertices (n, 3)."""
        return np.stack([vertex.position(points) for vertex in self._vertices])

    def at(self, points: Array, along_m: float) -> PathFoot:
        """Return the point at a length along the path."""
        along = min(max(along_m, 0.0), self.length_m)
        segment = min(int(np.searchsorted(self._along, along, side="right")) - 1, len(self._vertices) - 2)
        share = (along - self._along[segment]) / (self._along[segment + 1] - self._along[segment])
        return self._foot(points, segment, float(share))

    def nearest(self, points: Array, point: Array, from_m: float, to_m: float) -> PathFoot:
        """Return the point of the path nearest to a point (3,), among those with lengths along it from `from_m` to `to_m`."""
        positions = self.positions(points)
        start, way = positions[:-1], np.diff(positions, axis=0)
        lengths = np.diff(self._along)
        low = np.clip((from_m - self._along[:-1]) / lengths, 0.0, 1.0)
        high = np.clip((to_m - self._along[:-1]) / lengths, 0.0, 1.0)
        share = np.einsum("ij,ij->i", point - start, way) / np.einsum("ij,ij->i", way, way)
        share = np.clip(share, low, high)
        distance = np.linalg.norm(start + share[:, None] * way - point, axis=1)
        touched = (self._along[1:] >= from_m) & (self._along[:-1] <= to_m)
        segment = int(np.argmin(np.where(touched, distance, np.inf)))
        return self._foot(points, segment, float(share[segment]))

    def _foot(self, points: Array, segment: int, share: float) -> PathFoot:
        before, after = self._vertices[segment], self._vertices[segment + 1]
        normal = (1.0 - share) * before.normal(points) + share * after.normal(points)
        return PathFoot(
            along_m=float((1.0 - share) * self._along[segment] + share * self._along[segment + 1]),
            position=(1.0 - share) * before.position(points) + share * after.position(points),
            normal=normal / np.linalg.norm(normal),
        )
