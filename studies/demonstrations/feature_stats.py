"""Smallest, largest, mean and standard deviation of each feature, over an episode and over all."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Stats = dict[str, list[Any]]
"""`min`, `max`, `mean`, `std` and `count`, as LeRobot has them: of images by channel, (channels, 1, 1)."""

_BYTE = 255.0


def feature_stats(column: NDArray[Any], *, image: bool) -> Stats:
    """Return the statistics of a column, (rows, ...); those of images of bytes on a scale from 0 to 1."""
    values = column.astype(np.float64) / (_BYTE if image and column.dtype == np.uint8 else 1.0)
    axes = (0, 1, 2) if image else (0,)
    shape = (-1, 1, 1) if image else (-1,)
    found = {"min": values.min(axes), "max": values.max(axes), "mean": values.mean(axes), "std": values.std(axes)}
    return {**{name: np.reshape(value, shape).tolist() for name, value in found.items()}, "count": [len(column)]}


def joined_stats(parts: list[Mapping[str, Stats]]) -> dict[str, Stats]:
    """Return the statistics of all rows, by feature, from those of their parts.

    The variance is the mean of the parts' variances and of the squared distances of their means from that of all, weighted by
    their numbers of rows.
    """
    return {name: _joined([part[name] for part in parts]) for name in parts[0]}


def _joined(parts: list[Stats]) -> Stats:
    counts = np.array([part["count"][0] for part in parts], np.float64)
    least, most, means, deviations = (np.array([part[name] for part in parts]) for name in ("min", "max", "mean", "std"))
    weights = (counts / counts.sum()).reshape(-1, *([1] * (means.ndim - 1)))
    mean = (weights * means).sum(0)
    variance = (weights * (deviations**2 + (means - mean) ** 2)).sum(0)
    return {
        "min": least.min(0).tolist(),
        "max": most.max(0).tolist(),
        "mean": mean.tolist(),
        "std": np.sqrt(variance).tolist(),
        "count": [int(counts.sum())],
    }
