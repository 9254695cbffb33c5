"""The upper faces of organs on which others lie, and what makes shapes less regular."""

import math

import numpy as np

from laploop.arrays import Array, Float32
from laploop.assets.anatomy.anatomy_mesh import AnatomyMesh
from laploop.assets.anatomy.distance_grid import DistanceGrid
from laploop.assets.anatomy.paths import relief
from laploop.assets.tissue_appearance import plane_waves

_WAVES = 24
_BEND_WAVELENGTHS_M = (0.040, 0.120)
_RELIEF_WAVELENGTHS_M = (0.005, 0.025)


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


def above(grid: DistanceGrid, height: Array) -> Float32:
    """Return how far the grid's points are from the face at a height (nx, ny), negative below it, by the slope under each."""
    across, along = np.gradient(height, grid.spacing_m)
    steep = 1.0 / np.sqrt(1.0 + across**2 + along**2)
    return np.asarray((grid.coordinates[2] - height[:, :, None].astype(np.float32)) * steep[:, :, None].astype(np.float32))


def grown(mesh: AnatomyMesh, rng: np.random.Generator, *, bend_m: float = 0.004, relief_m: float = 0.0003) -> AnatomyMesh:
    """Return a mesh bent smoothly, by about `bend_m` at most, and roughened by fine relief: nothing that grows is regular.

    Both move space, not the surface along its normals: neighbouring points move together, however close they are, so that no
    triangle folds over.
    """
    points = mesh.points + rng.uniform(0.0, 0.5 * bend_m) * _moves(mesh.points, _BEND_WAVELENGTHS_M, rng)
    points = points + relief_m * rng.random() ** 2 * _moves(points, _RELIEF_WAVELENGTHS_M, rng)
    return AnatomyMesh(points=points, triangles=mesh.triangles, parts=mesh.parts)


def _moves(points: Array, wavelengths_m: tuple[float, float], rng: np.random.Generator) -> Array:
    """Return smooth random vectors at points (n, 3), each component with mean 0 and standard deviation 1."""
    waves, _ = plane_waves(points, wavelengths_m, _WAVES, rng)
    return np.asarray(waves @ rng.standard_normal((_WAVES, 3)) * np.sqrt(2.0 / _WAVES))
