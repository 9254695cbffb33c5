"""Cavities: looking into a hollow or a tube whose end lies 10 to 60 mm behind its rim."""

import math

import numpy as np

from laploop.assets.anatomy.anatomy_mesh import AnatomyMesh
from laploop.assets.anatomy.beds import above, bed, grown
from laploop.assets.anatomy.distance_grid import DistanceGrid
from laploop.assets.anatomy.paths import spline

_FLOOR_M = 0.005


def cavities(rng: np.random.Generator) -> AnatomyMesh:
    """Return a block with one wide hollow, or two or three narrow ones, smooth or with ring folds."""
    half = rng.uniform(0.062, 0.075)
    depth = rng.uniform(0.010, 0.060)
    grid = DistanceGrid([-half, -half, -depth - _FLOOR_M], [half, half, 0.008])
    grid.unite(above(grid, bed(grid, rng, rough_m=0.003, drop_m=depth + 2.0 * _FLOOR_M)))
    count = int(rng.integers(1, 4))
    wide = rng.uniform(0.022, 0.040) if count == 1 else rng.uniform(0.010, 0.018)
    turn = rng.uniform(0.0, 2.0 * math.pi)
    for number in range(count):
        angle = turn + 2.0 * math.pi * number / count
        place = np.zeros(2) if count == 1 else 0.026 * np.array([math.cos(angle), math.sin(angle)])
        own = max(0.006, depth * rng.uniform(0.6, 1.0))
        drift = rng.uniform(-0.35, 0.35, size=2) * own
        knots = [[*(place + drift * t**2), 0.012 - t * (own + 0.012)] for t in np.linspace(0.0, 1.0, 5)]
        path = spline(np.array(knots))
        along = np.linspace(0.0, 1.0, len(path))
        narrowing = 1.0 - rng.uniform(0.0, 0.5) * along
        rings = rng.uniform(0.0, 0.18) * np.exp(3.0 * (np.cos(2.0 * math.pi * along * rng.uniform(1.5, 6.0)) - 1.0))
        radii = np.minimum(wide * narrowing * (1.0 - rings), 0.65 * half)
        # The end stays above the floor.
        radii = np.minimum(radii, np.maximum(path[:, 2] + depth, 0.003))
        grid.carve(grid.tube(path, radii, 0.004), rng.uniform(0.001, 0.004))
    return grown(grid.surface(), rng)
