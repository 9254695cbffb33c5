"""Smooth lobes: unions of ellipsoid-like blobs that run into each other, from a liver's few to a gland's many."""

import numpy as np

from laploop.arrays import Array
from laploop.assets.anatomy.anatomy_mesh import AnatomyMesh
from laploop.assets.anatomy.beds import above, bed, grown
from laploop.assets.anatomy.distance_grid import DistanceGrid

Spheres = tuple[Array, Array]
"""Centres (k, 3) and radii (k,)."""


def smooth_lobes(rng: np.random.Generator) -> AnatomyMesh:
    """Return lobes 10 to 90 mm across on a common bed."""
    half = rng.uniform(0.060, 0.075)
    (centres, radii), blend = lobe_spheres(rng, half_width_m=0.8 * half)
    grid = DistanceGrid([-half, -half, -0.012], [half, half, float((centres[:, 2] + radii).max()) + 0.004])
    grid.add_spheres(centres, radii, blend)
    grid.unite(above(grid, bed(grid, rng, rough_m=0.006)), blend)
    return grown(grid.surface(), rng, bend_m=0.010)


def lobe_spheres(rng: np.random.Generator, *, half_width_m: float) -> tuple[Spheres, float]:
    """Draw spheres within a circle and the width over which they run into each other."""
    large = float(np.exp(rng.uniform(np.log(0.007), np.log(0.045))))
    count = int(np.clip(2.2 * (2.0 * half_width_m) ** 2 / (np.pi * large**2), 3, 140))
    radii = large * rng.uniform(0.6, 1.1, size=count)
    away, angle = half_width_m * np.sqrt(rng.random(count)), rng.uniform(0.0, 2.0 * np.pi, size=count)
    flat = np.column_stack([away * np.cos(angle), away * np.sin(angle)])
    highest = rng.uniform(0.012, 0.045)
    # A sphere's top lies between the bed and the highest point; large ones are sunk into the bed.
    top = highest * rng.uniform(0.5, 1.0, size=count)
    return (np.column_stack([flat, top - radii]), radii), float(rng.uniform(0.05, 0.5) * large)
