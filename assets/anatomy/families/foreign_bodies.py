"""Small spheres and rods scattered over an uneven bed: beads, clips, gallstones, pins."""

import numpy as np

from laploop.assets.anatomy.anatomy_mesh import AnatomyMesh
from laploop.assets.anatomy.beds import above, bed
from laploop.assets.anatomy.distance_grid import DistanceGrid


def foreign_bodies(rng: np.random.Generator) -> AnatomyMesh:
    """Return 8 to 40 bodies, 3 to 16 mm across, on a bed or standing out of it."""
    half = rng.uniform(0.060, 0.075)
    grid = DistanceGrid([-half, -half, -0.012], [half, half, 0.032])
    grid.unite(above(grid, bed(grid, rng, rough_m=0.004)))
    for _ in range(rng.integers(8, 41)):
        radius = rng.uniform(0.0015, 0.008)
        place = np.append(rng.uniform(-0.6, 0.6, size=2) * half, radius * rng.uniform(-0.2, 1.2))
        if rng.random() < 0.5:
            path = place[None]
        else:
            radius *= 0.4
            along = rng.standard_normal(3) * np.array([1.0, 1.0, 0.5])
            along *= rng.uniform(0.004, 0.016) / np.linalg.norm(along)
            place[2] = abs(along[2]) + radius * rng.uniform(-0.2, 1.2)
            path = np.linspace(place - along, place + along, max(2, int(2.0 * np.linalg.norm(along) / (0.4 * radius))))
        grid.add_tube(path, radius)
    return grid.surface(smoothing=0.4)
