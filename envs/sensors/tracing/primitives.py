"""Triangles for MuJoCo's primitive geoms, in the geom's own frame.

Vertices are shared where a surface is smooth and repeated at its edges: normals averaged over the triangles around a vertex
then come out smooth or sharp as they should. Triangles are oriented outwards.
"""

import math

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
Triangles = NDArray[np.int32]
Surface = tuple[Points, Triangles]

_SAG_M = 4e-6
"""Depth of a chord below its arc; chords are moved outwards by half of it, so that they intersect the round surface."""
_UNBOUNDED_M = 1.0
"""Half the size given to an infinite plane."""


def sphere(radius: float) -> Surface:
    """Tessellate a sphere."""
    return ellipsoid(radius, radius, radius)


def ellipsoid(a: float, b: float, c: float) -> Surface:
    """Tessellate an ellipsoid with the half axes `a`, `b`, `c` along x, y, z."""
    segments = _segments(max(a, b, c))
    angle = np.linspace(-math.pi / 2.0, math.pi / 2.0, segments // 2 + 1)
    points, triangles = _revolve(np.cos(angle), np.sin(angle), segments)
    # Half the sag along and half of it across.
    return points * np.array([a, b, c]) * (1.0 + _relative_sag(segments)), triangles


def capsule(radius: float, half_length: float) -> Surface:
    """Tessellate a capsule along z; `half_length` without the hemispheres."""
    segments = _segments(radius)
    radius *= 1.0 + 0.5 * _relative_sag(segments)
    angle = np.linspace(0.0, math.pi / 2.0, segments // 4 + 1)
    z_side = _cuts(half_length, radius)
    z = np.concatenate([-half_length - radius * np.sin(angle[:0:-1]), z_side, half_length + radius * np.sin(angle[1:])])
    r = np.concatenate([radius * np.cos(angle[:0:-1]), np.full(len(z_side), radius), radius * np.cos(angle[1:])])
    return _revolve(r, z, segments)


def cylinder(radius: float, half_length: float) -> Surface:
    """Tessellate a closed cylinder along z."""
    segments = _segments(radius)
    radius *= 1.0 + 0.5 * _relative_sag(segments)
    z_side = _cuts(half_length, radius)
    side = _revolve(np.full(len(z_side), radius), z_side, segments, closed=False)
    top = _revolve(np.array([radius, 0.0]), np.array([half_length, half_length]), segments)
    bottom = _revolve(np.array([0.0, radius]), np.array([-half_length, -half_length]), segments)
    return join([side, top, bottom])


def box(x: float, y: float, z: float) -> Surface:
    """Tessellate a box with the half sizes `x`, `y`, `z`."""
    half = np.array([x, y, z])
    faces = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            u, v = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
            normal = sign * np.eye(3)[axis]
            corners = np.array([normal - sign * u - v, normal + sign * u - v, normal + sign * u + v, normal - sign * u + v])
            faces.append((corners * half, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)))
    return join(faces)


def plane(x: float, y: float) -> Surface:
    """Tessellate a plane through the origin that faces +z; a half size of 0 means infinite, as in MuJoCo."""
    half_x, half_y = x or _UNBOUNDED_M, y or _UNBOUNDED_M
    points = np.array([[-half_x, -half_y, 0.0], [half_x, -half_y, 0.0], [half_x, half_y, 0.0], [-half_x, half_y, 0.0]])
    return points, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)


def facets(points: Points, triangles: Triangles) -> Surface:
    """Give every triangle vertices of its own, so that it is shaded flat."""
    return points[triangles].reshape(-1, 3), np.arange(triangles.size, dtype=np.int32).reshape(-1, 3)


def join(surfaces: list[Surface]) -> Surface:
    """Join several surfaces into one, without welding them."""
    offsets = np.cumsum([0] + [len(points) for points, _ in surfaces[:-1]])
    points = np.concatenate([points for points, _ in surfaces])
    triangles = np.concatenate([triangles + offset for (_, triangles), offset in zip(surfaces, offsets, strict=True)])
    return points, triangles.astype(np.int32)


def _segments(radius: float) -> int:
    """Return the number of chords around a circle, a multiple of 4, that keeps to the allowed sag."""
    count = math.pi / math.acos(max(1.0 - _SAG_M / radius, 0.0))
    return 4 * math.ceil(min(max(count, 12.0), 256.0) / 4.0)


def _relative_sag(segments: int) -> float:
    """Return the sag of a chord over the radius of its circle."""
    return 1.0 - math.cos(math.pi / segments)


def _cuts(half_length: float, radius: float) -> Points:
    """Cut a long side into pieces: slivers as long as the shaft would slow down the tree of bounding boxes."""
    pieces = max(1, math.ceil(half_length / (4.0 * radius)))
    return np.linspace(-half_length, half_length, pieces + 1)


def _revolve(r: Points, z: Points, segments: int, *, closed: bool = True) -> Surface:
    """Revolve the profile `r(z)`, bottom to top, about z.

    If `closed`, a ring whose radius is 0, up to rounding, becomes one vertex.
    """
    angle = np.arange(segments) * (2.0 * math.pi / segments)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    on_axis = closed & (r < 1e-9 * r.max())
    points: list[Points] = []
    rings: list[NDArray[np.int64]] = []
    count = 0
    for radius, height, pole in zip(r, z, on_axis, strict=True):
        if pole:
            points.append(np.array([[0.0, 0.0, height]]))
            rings.append(np.full(segments, count))
            count += 1
        else:
            points.append(np.column_stack([circle * radius, np.full(segments, height)]))
            rings.append(count + np.arange(segments))
            count += segments
    triangles = []
    for below, above, lower_pole, upper_pole in zip(rings, rings[1:], on_axis, on_axis[1:], strict=False):
        if not lower_pole:
            triangles.append(np.stack([below, np.roll(below, -1), above], axis=1))
        if not upper_pole:
            triangles.append(np.stack([np.roll(below, -1), np.roll(above, -1), above], axis=1))
    return np.concatenate(points), np.concatenate(triangles).astype(np.int32)
