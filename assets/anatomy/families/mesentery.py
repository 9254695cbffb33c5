"""Mesentery: a thin fan whose border, longer than its root, falls into ruffles, with or without the bowel it carries."""

import math

import numpy as np

from laploop.arrays import Array
from laploop.assets.anatomy.anatomy_mesh import AnatomyMesh, joined, vertex_normals
from laploop.assets.anatomy.distance_grid import DistanceGrid
from laploop.assets.anatomy.paths import relief

_SPACING_M = 7e-4


def mesentery(rng: np.random.Generator) -> AnatomyMesh:
    """Return a fan 80 to 120 mm wide and 1.5 to 4 mm thick with 4 to 14 ruffles."""
    inner, outer = rng.uniform(0.008, 0.020), rng.uniform(0.070, 0.100)
    opening = rng.uniform(math.radians(80.0), math.radians(150.0))
    ruffles, height = int(rng.integers(4, 15)), rng.uniform(0.004, 0.012)
    rows = round((outer - inner) / _SPACING_M)
    # The border is longer than its arc, by the slope of the ruffles.
    arc = outer * opening
    columns = round(0.8 * arc * math.sqrt(1.0 + 0.5 * (2.0 * math.pi * ruffles * height / arc) ** 2) / _SPACING_M)
    r = np.linspace(0.0, 1.0, rows)[:, None]
    a = np.linspace(-0.5, 0.5, columns)[None, :]
    phase = 2.0 * math.pi * ruffles * a + 1.5 * relief((1, columns), columns / 4.0, rng) + rng.uniform(-1.5, 1.5) * r
    z = height * r**1.8 * np.sin(phase) + rng.uniform(0.0, 0.008) * relief((rows, columns), 0.05 / _SPACING_M, rng)
    radius = inner + (outer - inner) * r * (1.0 + rng.uniform(0.0, 0.06) * np.cos(phase) * r)
    middle = 0.5 * (inner + outer)
    sheet = np.stack([radius * np.sin(opening * a), radius * np.cos(opening * a) - middle, z + 0.0 * radius], axis=-1)
    thick = rng.uniform(0.0015, 0.004) * (1.0 + 0.25 * relief((rows, columns), 0.008 / _SPACING_M, rng))
    meshes = [_thickened(sheet, np.maximum(thick, 0.0008))]
    if rng.random() < 0.6:
        border = sheet[-1]
        tube = rng.uniform(0.006, 0.011)
        grid = DistanceGrid.around(border, tube + 0.004)
        grid.add_tube(border, tube * (1.0 + 0.06 * relief((1, columns), 0.02 / _SPACING_M, rng)[0]))
        meshes.append(grid.surface())
    return joined(meshes)


def _thickened(sheet: Array, thick: Array) -> AnatomyMesh:
    """Return the closed surface at half the thickness (rows, columns) on either side of a sheet (rows, columns, 3)."""
    rows, columns = thick.shape
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    front = np.concatenate([np.stack([a, c, b], -1).reshape(-1, 3), np.stack([a, d, c], -1).reshape(-1, 3)])
    points = sheet.reshape(-1, 3)
    offset = 0.5 * thick.reshape(-1, 1) * vertex_normals(points, front)
    border = np.concatenate([index[:-1, 0], index[-1, :-1], index[:0:-1, -1], index[0, :0:-1]])
    after, count = np.roll(border, -1), rows * columns
    rim = np.concatenate([np.stack([border, after, after + count], -1), np.stack([border, after + count, border + count], -1)])
    triangles = np.concatenate([front, front[:, ::-1] + count, rim]).astype(np.int32)
    return AnatomyMesh(
        points=np.concatenate([points + offset, points - offset]),
        triangles=triangles,
        parts=np.zeros(len(triangles), dtype=np.int32),
    )
