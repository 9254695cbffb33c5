"""Smooth random curves, along which tubes and folds run, and smooth random relief."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.interpolate import CubicSpline

from laploop.arrays import Array

STEP_M = 1.2e-3
"""Distance of neighbouring points of a path."""


def wandering_path(length_m: float, half_width_m: float, bend_radius_m: float, rng: np.random.Generator) -> Array:
    """Return a path (k, 2) that meanders over a square around the origin and turns back at its border.

    Its curvature is smooth noise, at most 1 over `bend_radius_m`.
    """
    count = max(3, round(length_m / STEP_M))
    noise = ndimage.gaussian_filter1d(rng.standard_normal(count + 1), 0.6 * bend_radius_m / STEP_M, mode="wrap")
    wanted = np.clip(noise / max(float(noise.std()), 1e-12), -1.2, 1.2) / 1.2
    point, heading = rng.uniform(-half_width_m, half_width_m, size=2), rng.uniform(-math.pi, math.pi)
    path = np.empty((count, 2))
    for index in range(count):
        path[index] = point
        turn = wanted[index]
        if np.abs(point).max() > half_width_m:
            inward = math.atan2(-point[1], -point[0])
            off = (inward - heading + math.pi) % (2.0 * math.pi) - math.pi
            turn = math.copysign(1.0, off) if abs(off) > 0.3 else 0.0
        heading += turn * STEP_M / bend_radius_m
        point = point + STEP_M * np.array([math.cos(heading), math.sin(heading)])
    return path


def lowered(path: Array, radius: float, top: "HeightMap", sag: float, stiffness_m: float) -> Array:
    """Lay a path (k, 2) onto what is there already and return it in space, (k, 3), the axis of a tube of some radius.

    Args:
        path: Seen from above.
        radius: Of the tube.
        top: What is there; the tube is added to it.
        sag: Fraction of the radius by which the tube sinks into what it lies on.
        stiffness_m: Length over which the tube's height is smoothed.
    """
    support = ndimage.gaussian_filter1d(top.highest(path, 0.7 * radius), stiffness_m / STEP_M, mode="nearest")
    space = np.column_stack([path, support + (1.0 - sag) * radius])
    top.raise_over(space, radius)
    return space


class HeightMap:
    """Height of what lies below each point of a square, metres."""

    _PITCH_M = 1e-3

    def __init__(self, half_width_m: float) -> None:
        self._half = half_width_m
        self._line = np.arange(-half_width_m, half_width_m + self._PITCH_M, self._PITCH_M)
        self._height = np.zeros((len(self._line), len(self._line)))

    def highest(self, path: Array, radius: float) -> Array:
        """Return the greatest height within a radius of each point of a path (k, 2)."""
        highest = ndimage.maximum_filter(self._height, max(1, 2 * round(radius / self._PITCH_M) + 1))
        row, column = self._cells(path).T
        return np.asarray(highest[row, column])

    def raise_over(self, path: Array, radius: float) -> None:
        """Add a tube around a path (k, 3)."""
        reach = math.ceil(radius / self._PITCH_M)
        for (row, column), (x, y, z) in zip(self._cells(path[:, :2]), path, strict=True):
            rows = slice(max(0, row - reach), row + reach + 1)
            columns = slice(max(0, column - reach), column + reach + 1)
            square = (self._line[rows, None] - x) ** 2 + (self._line[None, columns] - y) ** 2
            under = np.where(square < radius**2, z + np.sqrt(np.maximum(radius**2 - square, 0.0)), 0.0)
            self._height[rows, columns] = np.maximum(self._height[rows, columns], under)

    def _cells(self, path: Array) -> NDArray[np.intp]:
        cells = np.rint((path + self._half) / self._PITCH_M).astype(int)
        return np.asarray(np.clip(cells, 0, len(self._line) - 1))


def spline(knots: Array, step_m: float = STEP_M) -> Array:
    """Return points (k, 3) about `step_m` apart on the natural cubic spline through some knots (n, 3)."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(knots, axis=0), axis=1))])
    count = max(2, math.ceil(along[-1] / step_m))
    return np.asarray(CubicSpline(along, knots, bc_type="natural")(np.linspace(0.0, along[-1], count)))


def arc_length(path: Array) -> Array:
    """Return the distance along a path (k, d) of each of its points from the first, (k,)."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])


def relief(shape: tuple[int, int], wavelength: float, rng: np.random.Generator) -> Array:
    """Return smooth noise on a grid, mean 0 and standard deviation 1, with details of about a wavelength, in samples."""
    noise = ndimage.gaussian_filter(rng.standard_normal(shape), wavelength / 4.0, mode="reflect")
    return np.asarray((noise - noise.mean()) / max(float(noise.std()), 1e-12))
