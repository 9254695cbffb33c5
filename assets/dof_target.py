"""A depth-of-field target: an inclined ruler beside a blank field, for optical characterisation."""

import math
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from laploop.assets.calibration_board import BoardSurface
from laploop.configuration import Field, configuration

_PAPER = 1.0
_INK = 0.15
_MM = 1e-3
_SEGMENTS = {"2": "abged", "5": "afgcd"}
"""Of a seven-segment digit: a top, b and c right, d bottom, e and f left, g middle."""


@configuration
class DepthOfFieldTarget:
    """A plane with a scale in millimetres that runs along its x axis and away from the camera.

    Frame: origin at the middle mark of the scale (25 mm), x along the scale, y across, z into the plane; the printed side
    faces -z. The upper part (negative y) is blank: stripes are measured there. The scale lies below, with a mark each
    millimetre, longer ones every 5 and 10 mm, the middle one thickest and numbered. Targets for measuring depth of field are
    commonly inclined by 45 degrees.
    """

    length_mm: Annotated[int, Field(ge=10, le=200, multiple_of=10)] = 50
    """Length of the scale."""
    tilt_rad: Annotated[float, Field(ge=0.0, le=math.radians(75.0))] = math.radians(45.0)
    """Angle between the scale and the plane that faces the camera."""
    mark_width_mm: Annotated[float, Field(ge=0.05, le=0.6)] = 0.25
    """Width of a mark; the middle one is three times as wide."""
    blank_height_mm: Annotated[float, Field(ge=2.0, le=100.0)] = 12.0
    """From the upper edge to the middle line."""
    ruled_height_mm: Annotated[float, Field(ge=19.0, le=100.0)] = 20.0
    """From the middle line to the lower edge; marks begin at 8 mm."""
    margin_mm: Annotated[float, Field(ge=1.0, le=50.0)] = 3.0
    """Paper beyond the first and the last mark."""

    @property
    def centre_mm(self) -> float:
        """Scale reading of the mark in the middle."""
        return 0.5 * self.length_mm

    def surface(self) -> BoardSurface:
        """Return the target's triangles."""
        ink = self._ink_mm()
        half = self.centre_mm + self.margin_mm
        x = np.unique(np.round([-half, half, *ink[:, 0], *ink[:, 1]], 6))
        y = np.unique(np.round([-self.blank_height_mm, self.ruled_height_mm, *ink[:, 2], *ink[:, 3]], 6))
        left, top = (grid.ravel() for grid in np.meshgrid(x[:-1], y[:-1], indexing="ij"))
        right, bottom = (grid.ravel() for grid in np.meshgrid(x[1:], y[1:], indexing="ij"))
        mid_x, mid_y = 0.5 * (left + right)[:, None], 0.5 * (top + bottom)[:, None]
        inked = ((mid_x > ink[:, 0]) & (mid_x < ink[:, 1]) & (mid_y > ink[:, 2]) & (mid_y < ink[:, 3])).any(axis=1)
        corners = np.stack([left, top, right, top, right, bottom, left, bottom], axis=1).reshape(-1, 2)
        points = np.column_stack([corners * _MM, np.zeros(len(corners))])
        first = 4 * np.arange(len(left), dtype=np.int32)[:, None, None]
        # Wound so that the normals point to -z, to the camera.
        triangles = (first + np.array([[0, 2, 1], [0, 3, 2]], dtype=np.int32)).reshape(-1, 3)
        return BoardSurface(points, triangles, np.repeat(np.where(inked, _INK, _PAPER), 4))

    def camera_from_target(self, distance_m: float) -> NDArray[np.float64]:
        """Place the middle mark on the axis of a computer-vision camera, the scale along the image's x and away from it.

        Returns:
            Rigid transform, 4x4.
        """
        cosine, sine = math.cos(self.tilt_rad), math.sin(self.tilt_rad)
        pose = np.eye(4)
        pose[:3, :3] = [[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]]
        pose[2, 3] = distance_m
        return pose

    def _ink_mm(self) -> NDArray[np.float64]:
        """Return the inked rectangles, (n, 4): left, right, top, bottom."""
        rows: list[tuple[float, float, float, float]] = []
        for mark in range(self.length_mm + 1):
            place = mark - self.centre_mm
            middle = place == 0.0
            width = self.mark_width_mm * (3.0 if middle else 1.0)
            length = 6.0 if middle or mark % 10 == 0 else 4.5 if mark % 5 == 0 else 3.0
            rows.append((place - 0.5 * width, place + 0.5 * width, 8.0, 8.0 + length))
        if self.centre_mm == 25.0:
            rows += _digit("2", -3.2) + _digit("5", 0.7)
        return np.array(rows)


def _digit(name: str, left: float) -> list[tuple[float, float, float, float]]:
    """Return the strokes of a digit 2.5 mm wide and 3.5 mm high below the marks."""
    top, width, height, pen = 15.0, 2.5, 3.5, 0.5
    right, bottom, middle = left + width, top + height, top + 0.5 * (height - pen)
    strokes = {
        "a": (left, right, top, top + pen),
        "b": (right - pen, right, top, middle + pen),
        "c": (right - pen, right, middle, bottom),
        "d": (left, right, bottom - pen, bottom),
        "e": (left, left + pen, middle, bottom),
        "f": (left, left + pen, top, middle + pen),
        "g": (left, right, middle, middle + pen),
    }
    return [strokes[segment] for segment in _SEGMENTS[name]]
