"""Strands and bands with gaps between them, as of adhesions and ligaments; a wall behind shows through."""

import numpy as np

from laploop.assets.anatomy.anatomy_mesh import AnatomyMesh
from laploop.assets.anatomy.beds import grown
from laploop.assets.anatomy.distance_grid import DistanceGrid
from laploop.assets.anatomy.paths import spline


def strands(rng: np.random.Generator) -> AnatomyMesh:
    """Return 6 to 24 strands, 1.5 to 10 mm thick, that cross each other, some with a nodule."""
    half, depth = rng.uniform(0.050, 0.062), rng.uniform(0.008, 0.035)
    grid = DistanceGrid([-half, -half, -0.008], [half, half, depth + 0.008])
    thick = float(np.exp(rng.uniform(np.log(0.001), np.log(0.004))))
    blend = rng.uniform(0.5, 3.0) * thick
    for _ in range(rng.integers(6, 25)):
        angle = rng.uniform(0.0, 2.0 * np.pi)
        along = np.array([np.cos(angle), np.sin(angle)])
        across = np.array([-along[1], along[0]]) * rng.uniform(-0.85, 0.85) * half
        ends = [np.append(across + side * 1.5 * half * along, rng.uniform(0.0, depth)) for side in (-1.0, 1.0)]
        knots = np.linspace(ends[0], ends[1], 6)
        knots[1:-1] += rng.normal(0.0, 1.0, size=(4, 3)) * np.array([0.004, 0.004, 0.002])
        # Slack sags away from the endoscope.
        knots[:, 2] -= rng.uniform(0.0, 0.006) * np.array([0.0, 0.6, 1.0, 1.0, 0.6, 0.0])
        own = thick * rng.uniform(0.6, 1.3)
        path = spline(knots, max(4e-4, 0.4 * own))
        part = np.linspace(-1.0, 1.0, len(path))
        radii = own * (1.0 + rng.uniform(0.0, 0.8) * part**4)
        if rng.random() < 0.3:
            radii = radii + own * rng.uniform(1.0, 2.5) * np.exp(-(((part - rng.uniform(-0.5, 0.5)) / 0.06) ** 2))
        grid.add_tube(path, radii, blend)
    return grown(grid.surface(), rng)
