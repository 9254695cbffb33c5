"""The upper faces of organs on which others lie, and what makes shapes less regular."""

import math

import numpy as np

from laploop.arrays import Array
from laploop.assets.anatomy.anatomy_mesh import AnatomyMesh, vertex_normals
from laploop.assets.anatomy.distance_grid import DistanceGrid
from laploop.assets.anatomy.paths import relief
from laploop.assets.tissue_appearance import gaussian_field

_WAVES = 12
_RELIEF_WAVELENGTHS_M = (0.003, 0.012)


def bed(grid: DistanceGrid, rng: np.random.Generator, *, rough_m: float, drop_m: float = 0.016) -> Array:
    """Return the height (nx, ny) of an uneven face around z = 0 that falls off by `drop_m` at an irregular outline."""
    x, y = grid.axes[0][:, None].astype(np.float64), grid.axes[1][None, :].astype(np.float64)
    angle = np.arctan2(y, x)
    reach = np.full(angle.shape, rng.uniform(0.80, 0.92))
    for order in (2, 3, 5):
        reach += rng.uniform(0.0, 0.10) / order * np.cos(order * angle + rng.uniform(0.0, 2.0 * math.pi))
    outwards = np.hypot(x, y) / (reach * float(grid.axes[0][-1]))
    uneven = rng.uniform(0.0, rough_m) * relief(angle.shape, rng.uniform(0.015, 0.06) / grid.spacing_m, rng)
    return np.asarray(uneven - drop_m * outwards ** rng.uniform(4.0, 12.0))


def above(grid: DistanceGrid, height: Array) -> Array:
    """Return how far the grid's points are above a height (nx, ny): the distances of what lies below it, to be united."""
    return np.asarray(grid.coordinates[2] - height[:, :, None].astype(np.float32))


def grown(mesh: AnatomyMesh, rng: np.random.Generator, *, bend_m: float = 0.004, relief_m: float = 0.0004) -> AnatomyMesh:
    """Return a mesh bent smoothly, by about `bend_m` at most, and roughened by fine relief: nothing that grows is regular.

    The bending has wavelengths of 40 to 120 mm: neighbouring points move together, so that the surface stays closed.
    """
    points, bend = mesh.points, rng.uniform(0.0, bend_m)
    moves = np.stack([gaussian_field(points, (0.040, 0.120), rng, waves=_WAVES) for _ in range(3)], axis=1)
    points = points + 0.5 * bend * moves
    fine = rng.uniform(0.0, relief_m) * gaussian_field(points, _RELIEF_WAVELENGTHS_M, rng, waves=3 * _WAVES)
    points = points + fine[:, None] * vertex_normals(points, mesh.triangles)
    return AnatomyMesh(points=points, triangles=mesh.triangles, parts=mesh.parts)
