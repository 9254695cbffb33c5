"""Folds that overhang: thick plates on a bed that lean to one side, with a rounded rim."""

import math

import numpy as np

from laploop.assets.anatomy.anatomy_mesh import AnatomyMesh
from laploop.assets.anatomy.beds import above, bed, grown
from laploop.assets.anatomy.distance_grid import DistanceGrid
from laploop.assets.anatomy.paths import STEP_M, wandering_path

_LEVELS = 14


def overhanging_folds(rng: np.random.Generator) -> AnatomyMesh:
    """Return folds 8 to 30 mm high and 3 to 9 mm thick that lean by up to 55 degrees."""
    half = rng.uniform(0.060, 0.075)
    height, thick = rng.uniform(0.008, 0.030), rng.uniform(0.0015, 0.0045)
    rim = thick * rng.uniform(1.0, 2.2)
    grid = DistanceGrid([-half, -half, -0.012], [half, half, height + rim + 0.004])
    grid.unite(above(grid, bed(grid, rng, rough_m=0.003)))
    lean = math.radians(rng.uniform(15.0, 55.0))
    blend = rng.uniform(0.001, 0.004)
    for _ in range(rng.integers(3, 9)):
        flat = wandering_path(rng.uniform(0.06, 0.16), 0.65 * half, rng.uniform(0.015, 0.06), rng)
        ahead = np.gradient(flat, axis=0)
        aside = np.column_stack([-ahead[:, 1], ahead[:, 0]]) / np.linalg.norm(ahead, axis=1, keepdims=True)
        # A fold rises from the bed at its ends.
        ends = np.minimum(np.arange(len(flat)), np.arange(len(flat))[::-1]) * STEP_M
        own = height * rng.uniform(0.7, 1.0) * np.minimum(1.0, ends / 0.012) ** 0.5
        level = np.linspace(0.0, 1.0, _LEVELS)
        # Leaning more towards the rim: out and over.
        out = math.tan(lean) * level**1.6
        path = np.empty((len(flat), _LEVELS, 3))
        path[..., :2] = flat[:, None] + aside[:, None] * (own[:, None] * out)[..., None]
        path[..., 2] = own[:, None] * level
        radii = np.broadcast_to(thick + (rim - thick) * level**6, (len(flat), _LEVELS))
        grid.add_tube(path.reshape(-1, 3), radii.ravel(), blend)
    return grown(grid.surface(), rng)
