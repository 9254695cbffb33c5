"""Fatty omentum: an apron of many small lobules of fat, with thin places and gaps."""

import numpy as np

from laploop.assets.anatomy.anatomy_mesh import AnatomyMesh
from laploop.assets.anatomy.beds import grown
from laploop.assets.anatomy.distance_grid import DistanceGrid
from laploop.assets.anatomy.paths import relief

_PITCH_M = 1e-3


def omentum(rng: np.random.Generator) -> AnatomyMesh:
    """Return 400 to 1600 lobules, 3 to 14 mm across, that hang on a wavy sheet."""
    half = rng.uniform(0.048, 0.060)
    mean = rng.uniform(0.0022, 0.0048)
    count = int(np.clip(2.0 * (2.0 * half) ** 2 / (np.pi * mean**2), 400, 1600))
    flat = rng.uniform(-half, half, size=(count, 2))
    samples = int(2.0 * half / _PITCH_M) + 1
    cell = tuple(np.minimum(((flat + half) / _PITCH_M).astype(int), samples - 1).T)
    sheet = rng.uniform(0.001, 0.009) * relief((samples, samples), rng.uniform(0.03, 0.09) / _PITCH_M, rng)[cell]
    density = relief((samples, samples), rng.uniform(0.015, 0.05) / _PITCH_M, rng)[cell]
    radii = mean * np.exp(rng.normal(0.0, 0.3, size=count) + 0.2 * density)
    kept = density > rng.uniform(-2.5, -0.6)
    centres = np.column_stack([flat, sheet + rng.normal(0.0, 0.4 * mean, size=count)])[kept]
    grid = DistanceGrid.around(centres, 2.0 * mean + 0.004)
    grid.add_spheres(centres, np.minimum(radii, 0.007)[kept], rng.uniform(0.15, 0.6) * mean)
    return grown(grid.surface(), rng)
