"""Sacs on a bed: pear-shaped as a gallbladder with its duct, or round as a bladder."""

import math

import numpy as np

from laploop.arrays import Array
from laploop.assets.anatomy.anatomy_mesh import AnatomyMesh
from laploop.assets.anatomy.beds import above, bed, grown
from laploop.assets.anatomy.distance_grid import DistanceGrid
from laploop.assets.anatomy.paths import spline


def sacs(rng: np.random.Generator) -> AnatomyMesh:
    """Return one to three sacs, 20 to 60 mm across, on an uneven bed."""
    half = rng.uniform(0.060, 0.078)
    bodies = [sac(rng, half_width_m=0.45 * half) for _ in range(rng.integers(1, 4))]
    highest = max(float((path[:, 2] + radii).max()) for path, radii in bodies)
    grid = DistanceGrid([-half, -half, -0.012], [half, half, highest + 0.004])
    grid.unite(above(grid, bed(grid, rng, rough_m=0.004)))
    for path, radii in bodies:
        grid.add_tube(path, radii, rng.uniform(0.001, 0.006))
    return grown(grid.surface(), rng)


def sac(rng: np.random.Generator, *, half_width_m: float) -> tuple[Array, Array]:
    """Draw the axis (k, 3) and the radii (k,) of a sac: a wide end, a neck, and sometimes a duct."""
    wide = rng.uniform(0.010, 0.024)
    length, angle = wide * rng.uniform(0.5, 3.0), rng.uniform(0.0, 2.0 * math.pi)
    start = rng.uniform(-half_width_m, half_width_m, size=2)
    ahead = np.array([math.cos(angle), math.sin(angle)])
    aside = np.array([-ahead[1], ahead[0]]) * rng.uniform(-0.4, 0.4)
    lift = rng.uniform(0.2, 0.9) * wide
    knots = np.array([[*(start + t * length * (ahead + t * aside)), lift * (1.0 - 0.4 * t)] for t in np.linspace(0.0, 1.0, 5)])
    path = spline(knots)
    along = np.linspace(0.0, 1.0, len(path))
    neck = rng.uniform(0.15, 0.9)
    radii = wide * (1.0 - (1.0 - neck) * along**1.5)
    if rng.random() < 0.5:
        drop = length * rng.uniform(0.5, 1.5) * np.array([*ahead, -0.1])
        duct = spline(np.array([path[-1], path[-1] + 0.5 * drop, path[-1] + drop + rng.normal(0.0, 0.004, size=3)]), 6e-4)
        path = np.concatenate([path, duct])
        radii = np.concatenate([radii, np.geomspace(radii[-1], rng.uniform(0.0015, 0.004), len(duct))])
    return path, radii
