"""Depth in colours over the picture that it was read from, with a bar that says what the colours mean."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from laploop.perception.working_range import WORKING_RANGE_MM

_OPACITY = 0.6
"""Of the colours: the stripes stay visible."""
_SMALLEST_SIDE_PX = 512
"""Smaller pictures are enlarged by a whole factor, so that the bar's numbers can be read."""
_BAR_PX, _GAP_PX, _TEXT_PX = 18, 12, 74
_TICKS = 6
_STEP_MM = 5.0
"""The bar begins and ends at multiples."""


def draw_overlay(image: NDArray[np.uint8], depth_mm: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Draw depth (H, W), NaN where invalid, over a grey picture (H, W); invalid pixels stay grey.

    Returns:
        (height, width, 3) in OpenCV's order blue, green, red, with the colour bar at the right.
    """
    valid = np.isfinite(depth_mm)
    low, high = _limits(depth_mm[valid])
    level = np.clip((np.where(valid, depth_mm, low) - low) / (high - low), 0.0, 1.0)
    colours = cv2.applyColorMap(np.round(255.0 * level).astype(np.uint8), cv2.COLORMAP_VIRIDIS).astype(np.float32)
    grey = np.repeat(image[..., None], 3, axis=-1).astype(np.float32)
    mixed = np.where(valid[..., None], _OPACITY * colours + (1.0 - _OPACITY) * grey, grey)
    factor = max(1, math.ceil(_SMALLEST_SIDE_PX / min(image.shape)))
    enlarged = np.kron(np.round(mixed).astype(np.uint8), np.ones((factor, factor, 1), dtype=np.uint8))
    return np.concatenate([enlarged, _colour_bar(enlarged.shape[0], low, high)], axis=1)


def _limits(depths_mm: NDArray[np.float32]) -> tuple[float, float]:
    """Return the depths that the colours span: nearly all valid ones, rounded outwards; the scope's if none is."""
    if not depths_mm.size:
        return WORKING_RANGE_MM
    low, high = np.percentile(depths_mm, (1.0, 99.0))
    first = _STEP_MM * math.floor(low / _STEP_MM)
    return first, max(first + _STEP_MM, _STEP_MM * math.ceil(high / _STEP_MM))


def _colour_bar(height: int, low: float, high: float) -> NDArray[np.uint8]:
    """Draw the bar with its numbers, the far end at the top."""
    page = np.full((height, _GAP_PX + _BAR_PX + _TEXT_PX, 3), 255, dtype=np.uint8)
    first, last = 2 * _GAP_PX, height - 2 * _GAP_PX
    ramp = np.linspace(255.0, 0.0, last - first).round().astype(np.uint8)[:, None]
    page[first:last, _GAP_PX : _GAP_PX + _BAR_PX] = cv2.applyColorMap(ramp, cv2.COLORMAP_VIRIDIS)
    for tick in range(_TICKS):
        fraction = tick / (_TICKS - 1)
        row = round(last - 1 - fraction * (last - 1 - first))
        text = f"{low + fraction * (high - low):g}" + (" mm" if tick == _TICKS - 1 else "")
        place = (_GAP_PX + _BAR_PX + 6, row + 5)
        cv2.line(page, (_GAP_PX + _BAR_PX, row), (_GAP_PX + _BAR_PX + 3, row), (0, 0, 0), 1)
        cv2.putText(page, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 1, cv2.LINE_AA)
    return page
