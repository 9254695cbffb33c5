"""Resected organs: cut steps, notches and holes with sharp edges in a smooth surface."""

import math

import numpy as np

from laploop.assets.anatomy.anatomy_mesh import AnatomyMesh
from laploop.assets.anatomy.beds import above, bed
from laploop.assets.anatomy.distance_grid import DistanceGrid


def resections(rng: np.random.Generator) -> AnatomyMesh:
    """Return a smooth organ with two to six cuts, 3 to 20 mm deep."""
    half, height = rng.uniform(0.062, 0.075), rng.uniform(0.014, 0.030)
    grid = DistanceGrid([-half, -half, 0.0], [half, half, height + 0.012])
    x, y, z = grid.coordinates
    dome = height - rng.uniform(0.0, 4.0) * (x[..., 0] ** 2 + y[..., 0] ** 2)
    grid.unite(above(grid, dome + bed(grid, rng, rough_m=0.003, drop_m=height + 0.004)))
    for _ in range(rng.integers(2, 7)):
        turn = rng.uniform(0.0, math.pi)
        centre = rng.uniform(-0.7, 0.7, size=2) * 0.7 * half
        u = (x - centre[0]) * math.cos(turn) + (y - centre[1]) * math.sin(turn)
        v = (y - centre[1]) * math.cos(turn) - (x - centre[0]) * math.sin(turn)
        bottom = height - rng.uniform(0.003, min(0.020, height))
        kind = rng.integers(3)
        slope = math.tan(math.radians(rng.uniform(-15.0, 15.0)))
        higher = np.float32(bottom) - z
        if kind == 0:
            # A step: all beyond a line is cut off.
            cut = np.maximum(-u - np.float32(slope) * z, higher)
        elif kind == 1:
            widths = rng.uniform(0.003, 0.018, size=2)
            cut = np.maximum(np.maximum(np.abs(u) - widths[0], np.abs(v) - widths[1]), higher)
        else:
            cut = np.maximum(np.sqrt(u**2 + v**2) - rng.uniform(0.002, 0.012) + np.float32(slope) * z, higher)
        grid.carve(np.asarray(cut, dtype=np.float32))
    return grid.surface(smoothing=0.6)
