"""Organs as bodies that a theatre can carry as its phantom: one closed surface on a flat base."""

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from laploop.arrays import Array
from laploop.assets.anatomy.anatomy_mesh import AnatomyMesh
from laploop.assets.anatomy.distance_grid import DistanceGrid, rounded_box
from laploop.assets.anatomy.families.bowel import bowel_tubes
from laploop.assets.anatomy.families.lobes import lobe_spheres
from laploop.assets.anatomy.families.sacs import sac
from laploop.assets.anatomy.families.stomach import stomach_axis
from laploop.errors import UnknownNameError

_SPACING_M = 1.9e-3
"""Coarser than what is only looked at: at most 50 000 triangles, and nothing that tetrahedra of 4 mm cannot fill."""
_HALF_WIDTH_M = 0.045
_BASE_M = 0.010
_HIGHEST_M = 0.045
_BLEND_M = 0.004
"""Clefts are rounded so far that tissue fills them."""


def phantom_body(family: str, rng: np.random.Generator) -> AnatomyMesh:
    """Return an organ of a family, 90 to 170 mm wide and 20 to 60 mm high, that stands on z = 0.

    Raises:
        UnknownNameError: If there is no phantom of that family.
        InvalidValueError: If scikit-image (extra `mesh`) is not installed.
    """
    if family not in PHANTOMS:
        raise UnknownNameError("family of phantoms", family, PHANTOMS)
    grid = _grid()
    PHANTOMS[family](grid, rng)
    half = _HALF_WIDTH_M + 0.010
    base = rounded_box(grid, (0.0, 0.0, 0.5 * _BASE_M), (half, half, 0.5 * _BASE_M), 0.4 * _BASE_M)
    grid.unite(base, _BLEND_M)
    # What hangs below the plate is cut off.
    grid.carve(np.broadcast_to(grid.coordinates[2], grid.values.shape))
    grid.smooth(1.0)
    grid.keep_one_body()
    body = grid.surface(smoothing=0.0)
    return AnatomyMesh(points=body.points - [0.0, 0.0, body.points[:, 2].min()], triangles=body.triangles, parts=body.parts)


def _bowel(grid: DistanceGrid, rng: np.random.Generator) -> None:
    for path, radii in bowel_tubes(rng, half_width_m=_HALF_WIDTH_M - 0.010):
        grid.add_tube(_within(path, radii) + [0.0, 0.0, 0.4 * _BASE_M], radii, _BLEND_M)


def _lobes(grid: DistanceGrid, rng: np.random.Generator) -> None:
    (centres, radii), blend = lobe_spheres(rng, half_width_m=_HALF_WIDTH_M)
    grid.add_spheres(centres + [0.0, 0.0, 0.5 * _BASE_M], radii, max(blend, _BLEND_M))


def _sacs(grid: DistanceGrid, rng: np.random.Generator) -> None:
    for _ in range(rng.integers(1, 4)):
        path, radii = sac(rng, half_width_m=0.5 * _HALF_WIDTH_M)
        grid.add_tube(path + [0.0, 0.0, _BASE_M], np.maximum(radii, _BLEND_M), _BLEND_M)


def _stomach(grid: DistanceGrid, rng: np.random.Generator) -> None:
    path, radii = stomach_axis(rng)
    grid.add_tube(0.8 * path + [0.0, 0.0, _BASE_M + 0.010], 0.85 * radii, 2.0 * _BLEND_M)


PHANTOMS: Mapping[str, Callable[[DistanceGrid, np.random.Generator], None]] = MappingProxyType(
    {"bowel-loops": _bowel, "lobes": _lobes, "sacs": _sacs, "stomach": _stomach}
)
"""What adds the organ of a family, which stands on a base, to a grid."""


def _grid() -> DistanceGrid:
    half = _HALF_WIDTH_M + 0.040
    return DistanceGrid([-half, -half, -2.0 * _SPACING_M], [half, half, _HIGHEST_M + 0.030], _SPACING_M)


def _within(path: Array, radii: Array) -> Array:
    """Return a tube's axis (k, 3) lowered to where the tube stays below the highest point."""
    lowered = path.copy()
    lowered[:, 2] = np.minimum(path[:, 2], _HIGHEST_M - radii)
    return lowered
