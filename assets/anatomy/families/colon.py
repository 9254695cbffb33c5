"""Haustrated colon: a wide tube that three taeniae gather into sacs."""

import math

import numpy as np
from scipy.spatial import cKDTree

from laploop.arrays import Array
from laploop.assets.anatomy.anatomy_mesh import AnatomyMesh
from laploop.assets.anatomy.beds import grown
from laploop.assets.anatomy.distance_grid import DistanceGrid
from laploop.assets.anatomy.paths import arc_length, wandering_path

_TAENIAE = 3
_TAENIA_HALF_WIDTH_M = 0.004
"""Taeniae are 6 to 10 mm wide."""


def colon(rng: np.random.Generator) -> AnatomyMesh:
    """Return one bent colon, 32 to 56 mm across, its haustra 15 to 35 mm long."""
    radius = rng.uniform(0.016, 0.028)
    flat = wandering_path(rng.uniform(0.12, 0.22), 0.050, rng.uniform(2.0, 4.0) * radius, rng)
    rise = rng.uniform(0.0, 0.010) * np.sin(np.linspace(0.0, rng.uniform(1.0, 6.0), len(flat)))
    path = np.column_stack([flat - flat.mean(axis=0), rise])
    grid = DistanceGrid.around(path, radius + 0.006)
    grid.add_tube(path, radius)
    body = grid.surface()
    points = haustrated(body.points, path, radius, rng)
    return grown(AnatomyMesh(points=points, triangles=body.triangles, parts=body.parts), rng)


def haustrated(points: Array, path: Array, radius: float, rng: np.random.Generator) -> Array:
    """Move the points (n, 3) of a tube around a path (k, 3) towards its axis, in clefts and under the taeniae."""
    nearest = cKDTree(path).query(points)[1]
    ahead = np.gradient(path, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    side = _transported(ahead)
    away = points - path[nearest]
    along = arc_length(path)[nearest] + np.einsum("ij,ij->i", away, ahead[nearest])
    u = np.einsum("ij,ij->i", away, side[nearest])
    v = np.einsum("ij,ij->i", away, np.cross(ahead, side)[nearest])
    angle = np.arctan2(v, u) - rng.uniform(0.0, 2.0 * math.pi)
    # From the middle of the nearest taenia, along the circumference.
    sector = 2.0 * math.pi / _TAENIAE
    third = np.floor(angle / sector + 0.5).astype(int)
    beside = np.abs(angle - third * sector) * radius
    free = 1.0 - np.exp(-((beside / (1.6 * _TAENIA_HALF_WIDTH_M)) ** 2))
    period = rng.uniform(0.015, 0.035)
    # The clefts of a row of haustra lie between those of its neighbours.
    shift = rng.uniform(0.0, 1.0, size=_TAENIAE)[(np.floor(angle / sector).astype(int)) % _TAENIAE]
    phase = np.abs((along / period + shift) % 1.0 - 0.5) * 2.0
    cleft = np.exp(-(((1.0 - phase) / rng.uniform(0.10, 0.25)) ** 2))
    depth = radius * (rng.uniform(0.12, 0.30) * cleft * free + rng.uniform(0.08, 0.20) * (1.0 - free))
    length = np.linalg.norm(away, axis=1)
    return np.asarray(points - away * (np.minimum(depth, 0.6 * length) / np.maximum(length, 1e-9))[:, None])


def _transported(ahead: Array) -> Array:
    """Return unit vectors (k, 3) across unit tangents (k, 3) that turn about the path as little as possible."""
    side = np.empty_like(ahead)
    across = np.cross(ahead[0], [0.0, 0.0, 1.0])
    for index, tangent in enumerate(ahead):
        across = across - (across @ tangent) * tangent
        across /= np.linalg.norm(across)
        side[index] = across
    return side
