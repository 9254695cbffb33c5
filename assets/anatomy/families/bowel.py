"""Loops of small bowel over each other: tubes with peristaltic segments, each lying on those before."""

import math

import numpy as np

from laploop.arrays import Array
from laploop.assets.anatomy.anatomy_mesh import AnatomyMesh
from laploop.assets.anatomy.beds import grown
from laploop.assets.anatomy.distance_grid import DistanceGrid
from laploop.assets.anatomy.paths import HeightMap, arc_length, lowered, wandering_path

_MARGIN_M = 0.004
_HIGHEST_M = 0.055

Tube = tuple[Array, Array]
"""Axis (k, 3) and radii (k,)."""


def bowel_loops(rng: np.random.Generator) -> AnatomyMesh:
    """Return loops 16 to 32 mm across (small bowel, collapsed to inflated), with creases and gaps between them."""
    tubes = bowel_tubes(rng, half_width_m=rng.uniform(0.045, 0.060))
    grid = DistanceGrid.around(np.concatenate([path for path, _ in tubes]), _MARGIN_M + max(float(r.max()) for _, r in tubes))
    blend = rng.uniform(0.0, 0.002)
    for path, radii in tubes:
        grid.add_tube(path, radii, blend)
    return grown(grid.surface(), rng)


def bowel_tubes(rng: np.random.Generator, *, half_width_m: float) -> list[Tube]:
    """Draw the axes and radii of several loops within a square around the origin."""
    radius = rng.uniform(0.008, 0.016)
    top = HeightMap(half_width_m + 2.0 * radius)
    covered, wanted = 0.0, rng.uniform(0.8, 1.8) * (2.0 * half_width_m) ** 2
    tubes: list[Tube] = []
    while covered < wanted:
        own = radius * rng.uniform(0.85, 1.15)
        length = rng.uniform(0.12, 0.30)
        flat = wandering_path(length, half_width_m, own * rng.uniform(1.4, 3.0), rng)
        path = lowered(flat, own, top, sag=rng.uniform(0.1, 0.3), stiffness_m=1.2 * own)
        path[:, 2] = np.minimum(path[:, 2], _HIGHEST_M - own)
        tubes.append((path, own * segments(arc_length(path), own, rng)))
        covered += length * 2.0 * own
    return tubes


def segments(along: Array, radius: float, rng: np.random.Generator) -> Array:
    """Return the factor on a tube's radius of its contractions at points (k,) along it; round ends are no part of it."""
    depth, period = rng.uniform(0.0, 0.16), radius * rng.uniform(1.5, 4.0)
    phase = 2.0 * math.pi * along / period + rng.uniform(0.0, 2.0 * math.pi)
    # Contractions are narrower than what bulges between them.
    return np.asarray(1.0 - depth * np.exp(2.0 * (np.cos(phase) - 1.0)))
