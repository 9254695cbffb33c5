"""Walls: a plane with or without steps and bumps, as a family of its own and behind other organs."""

import math

import numpy as np

from laploop.arrays import Array
from laploop.assets.anatomy.anatomy_mesh import AnatomyMesh
from laploop.assets.anatomy.paths import relief

_SPACING_M = 9e-4
_BACK_SAMPLES = 201
_BACK_HALF_M = 0.220
_BACK_GRADING = 2.2
"""A millimetre between points of the back wall in its middle, five at its border."""
_ROUND_M = 0.100
"""Distance from the middle at which the curvature of the back wall fades."""


def wall(rng: np.random.Generator) -> AnatomyMesh:
    """Return a wall that is flat in three of ten cases, else with steps, bumps or both."""
    x, y, height = _plane(rng.uniform(0.080, 0.110), _SPACING_M)
    if rng.random() < 0.3:
        return _slab(x, y, height)
    if rng.random() < 0.6:
        for _ in range(rng.integers(1, 5)):
            turn, shift = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(-0.04, 0.04)
            beyond = x * math.cos(turn) + y * math.sin(turn) > shift
            height = height + rng.uniform(-0.012, 0.012) * beyond
    if rng.random() < 0.7:
        for _ in range(rng.integers(3, 30)):
            centre, width = rng.uniform(-0.06, 0.06, size=2), rng.uniform(0.002, 0.015)
            square = (x - centre[0]) ** 2 + (y - centre[1]) ** 2
            height = height + rng.uniform(-0.6, 0.9) * width * np.exp(-0.5 * square / width**2)
    if rng.random() < 0.5:
        height = height + rng.uniform(0.0, 0.004) * relief(x.shape, rng.uniform(0.01, 0.08) / _SPACING_M, rng)
    return _slab(x, y, height)


def back_wall(rng: np.random.Generator) -> AnatomyMesh:
    """Return a wall, 440 mm wide and around z = 0, to stand behind an organ: flat, curved or uneven, and tilted."""
    graded = np.sinh(np.linspace(-_BACK_GRADING, _BACK_GRADING, _BACK_SAMPLES)) / math.sinh(_BACK_GRADING)
    x, y = np.meshgrid(_BACK_HALF_M * graded, _BACK_HALF_M * graded, indexing="ij")
    height = np.zeros_like(x)
    turn, tilt = rng.uniform(0.0, 2.0 * math.pi), math.tan(math.radians(rng.uniform(0.0, 18.0)))
    height = height + tilt * (x * math.cos(turn) + y * math.sin(turn))
    if rng.random() < 0.6:
        square = x**2 + y**2
        height = height + rng.uniform(-3.0, 4.0) * square / (1.0 + square / _ROUND_M**2)
    if rng.random() < 0.6:
        height = height + rng.uniform(0.0, 0.006) * relief(x.shape, rng.uniform(20.0, 100.0), rng)
    return _slab(x, y, height)


def _plane(half_m: float, spacing_m: float) -> tuple[Array, Array, Array]:
    """Return x, y and the height 0 of a square of points."""
    line = np.arange(-half_m, half_m + 0.5 * spacing_m, spacing_m)
    x, y = np.meshgrid(line, line, indexing="ij")
    return x, y, np.zeros_like(x)


def _slab(x: Array, y: Array, height: Array) -> AnatomyMesh:
    """Return the closed surface between a height field and a flat back, whose border it shares as a skirt."""
    rows, columns = x.shape
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    front = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    # Once around, anticlockwise from above.
    border = np.concatenate([index[:-1, 0], index[-1, :-1], index[:0:-1, -1], index[0, :0:-1]])
    behind = rows * columns + np.arange(len(border))
    back = float(height.min()) - 0.004
    middle = rows * columns + len(border)
    after, after_behind = np.roll(border, -1), np.roll(behind, -1)
    skirt = np.concatenate([np.stack([border, behind, after_behind], -1), np.stack([border, after_behind, after], -1)])
    bottom = np.stack([np.full(len(border), middle), after_behind, behind], -1)
    top = np.column_stack([x.ravel(), y.ravel(), height.ravel()])
    rim = np.column_stack([top[border, :2], np.full(len(border), back)])
    triangles = np.concatenate([front, skirt, bottom]).astype(np.int32)
    return AnatomyMesh(
        points=np.concatenate([top, rim, [[0.0, 0.0, back]]]),
        triangles=triangles,
        parts=np.zeros(len(triangles), dtype=np.int32),
    )
