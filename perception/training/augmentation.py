"""Changes of an image that leave its depth as it is."""

import cv2
import numpy as np
from numpy.typing import NDArray

from laploop.perception.training.recipe import Sample

_COARSEST_PX = (3.0, 40.0)
_RIM_PX = (0.4, 1.2)
_COVERED = (0.05, 0.5)
_FACTOR = (0.25, 1.6)
_LAYERS = 3


def painted(sample: Sample, rng: np.random.Generator) -> Sample:
    """Paint spots, bands and vessel-like lines with sharp rims onto what the image shows.

    Scenes have textures of their own; no finite set of them keeps a network from taking the edge of a pattern for that of a
    stripe. Noise is scaled with the light, which is a little wrong, and of no account beside the noise that there is.
    """
    image = sample["image"].astype(np.float32)
    for _ in range(int(rng.integers(1, _LAYERS + 1))):
        image *= _layer(image.shape, rng)
    return {**sample, "image": np.clip(np.round(image), 0.0, 255.0).astype(np.uint8)}


def _layer(shape: tuple[int, ...], rng: np.random.Generator) -> NDArray[np.float32]:
    """Return a factor around 1 with two levels: where a smooth random field is high (spots), or near its middle (lines)."""
    height, width = shape
    size = np.exp(rng.uniform(*np.log(_COARSEST_PX)))
    stretch = np.exp(rng.uniform(-0.7, 0.7))
    grid = (max(4, round(height / size * stretch)), max(4, round(width / size / stretch)))
    noise = rng.standard_normal(grid, dtype=np.float32)
    field = cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC)
    if rng.random() < 0.5:
        field = -np.abs(field)
    threshold = np.quantile(field, 1.0 - rng.uniform(*_COVERED))
    slope = np.abs(np.diff(field, axis=1)).mean()
    inside = np.clip((field - threshold) / (slope * rng.uniform(*_RIM_PX)) + 0.5, 0.0, 1.0)
    factor = np.exp(rng.uniform(*np.log(_FACTOR)))
    return np.asarray(1.0 + (factor - 1.0) * inside, dtype=np.float32)
