"""A depth-of-field target: an inclined ruler beside a blank field, for optical characterisation."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from laploop.errors import InvalidValueError, check_range

_PAPER = 1.0
_INK = 0.15
_MM = 1e-3
_SEGMENTS = {"2": "abged", "5": "afgcd"}
"""Of a seven-segment digit: a top, b and c right, d bottom, e and f left, g middle."""


class TargetSurface(NamedTuple):
    """Triangles of a target in its own frame; no vertex is shared between cells, so that ink ends sharply."""

    points: NDArray[np.float64]
    """(n, 3), metres."""
    triangles: NDArray[np.int32]
    """(m, 3), rows of `points`; the printed side faces -z."""
    albedo_factor: NDArray[np.float64]
    """(n,): 1 on blank paper, less on ink."""


@dataclass(frozen=True, kw_only=True)
class DepthOfFieldTarget:
    """A plane with a scale in millimetres that runs along its x axis and away from the camera.

    Frame: origin at the middle mark of the scale (25 mm), x along the scale, y across, z into the plane; the printed side
    faces -z. The upper part (negative y) is blank: stripes are measured there. The scale with its marks lies below, a mark a
    millimetre, longer at 5 and 10 mm, the one in the middle thickest and numbered. Targets for measuring depth of field are
    commonly inclined by 45 degrees.
    """

    length_mm: int = 50
    """Length of the scale; a multiple of ten."""
    tilt_rad: float = math.radians(45.0)
    """Angle between the scale and the plane that faces the camera."""
    mark_width_mm: float = 0.25
    blank_height_mm: float = 12.0
    """From the upper edge to the middle line."""
    ruled_height_mm: float = 20.0
    """From the middle line to the lower edge; marks begin at 8 mm."""
    margin_mm: float = 3.0
    """Paper beyond the first and the last mark."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a field lies outside its range.
        """
        if not (10 <= self.length_mm <= 200 and self.length_mm % 10 == 0):
            raise InvalidValueError("length_mm", self.length_mm, "a multiple of 10 from 10 to 200")
        for name, low, high in (
            ("tilt_rad", 0.0, math.radians(75.0)),
            ("mark_width_mm", 0.05, 0.6),
            ("blank_height_mm", 2.0, 100.0),
            ("ruled_height_mm", 19.0, 100.0),
            ("margin_mm", 1.0, 50.0),
        ):
            check_range(name, getattr(self, name), low, high)

    @property
    def centre_mm(self) -> float:
        """Scale reading of the mark in the middle."""
        return 0.5 * self.length_mm

    def surface(self) -> TargetSurface:
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
        return TargetSurface(points, triangles, np.repeat(np.where(inked, _INK, _PAPER), 4))

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
