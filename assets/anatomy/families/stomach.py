"""A stomach-like organ: a bent sac, wide above and narrow below, with the tubes that lead in and out."""

import numpy as np
from scipy.interpolate import PchipInterpolator

from laploop.arrays import Array
from laploop.assets.anatomy.anatomy_mesh import AnatomyMesh
from laploop.assets.anatomy.beds import grown
from laploop.assets.anatomy.distance_grid import DistanceGrid
from laploop.assets.anatomy.paths import spline


def stomach(rng: np.random.Generator) -> AnatomyMesh:
    """Return one organ, 80 to 120 mm long and 36 to 64 mm wide."""
    path, radii = stomach_axis(rng)
    grid = DistanceGrid.around(path, float(radii.max()) + 0.004)
    grid.add_tube(path, radii)
    return grown(grid.surface(smoothing=1.2), rng, bend_m=0.010)


def stomach_axis(rng: np.random.Generator) -> tuple[Array, Array]:
    """Draw the axis (k, 3), around the origin, and the radii (k,)."""
    size = rng.uniform(0.85, 1.15)
    # The axis of a stomach, at about half its size, so that the view holds it.
    knots = np.array(
        [
            [-0.012, 0.062, 0.000],
            [-0.012, 0.040, 0.004],
            [-0.020, 0.018, 0.006],
            [-0.014, -0.012, 0.006],
            [0.010, -0.032, 0.004],
            [0.036, -0.028, 0.000],
            [0.056, -0.010, -0.004],
        ]
    )
    knots = size * (knots + rng.normal(0.0, 0.004, size=knots.shape))
    widths = size * np.array([0.006, 0.010, 0.024, 0.023, 0.019, 0.012, 0.008]) * rng.uniform(0.85, 1.2, size=7)
    path = spline(knots)
    radii = PchipInterpolator(np.linspace(0.0, 1.0, 7), widths)(np.linspace(0.0, 1.0, len(path)))
    turn = rng.uniform(0.0, 2.0 * np.pi)
    rotation = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    return (path - path.mean(axis=0)) @ rotation.T, radii
