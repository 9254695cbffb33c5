"""A checkerboard for the calibration of cameras."""

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from laploop.configuration import Field, configuration
from laploop.errors import InvalidValueError, check_range

_PAPER = 1.0
_INK = 0.1
_MM = 1e-3


class BoardSurface(NamedTuple):
    """Triangles of a printed plane in its own frame; cells share no vertex, so that ink may end sharply."""

    points: NDArray[np.float64]
    """(n, 3), metres."""
    triangles: NDArray[np.int32]
    """(m, 3), rows of `points`; the printed side faces -z."""
    albedo_factor: NDArray[np.float64]
    """(n,): 1 on blank paper, less on ink."""


Squares = Annotated[int, Field(ge=4, le=40)]


@configuration
class CalibrationBoard:
    """A matte plane with dark and bright squares and a blank border.

    Frame: origin at the first inner corner, x along the rows of corners, y down the columns, z into the plane; the printed
    side faces -z, so that a camera that looks straight at it has parallel axes. The square left of and above the first corner
    is dark; with an odd and an even number of squares along the two sides the opposite one is bright, so that a picture shows
    which corner is the first.

    The default fills half of a 60 degree view at 95 mm, its squares 13 to 22 pixels wide at 120 to 70 mm with 256 pixels
    across. The markers of a ChArUco board would have modules of 2 to 3 pixels, too few to be read.
    """

    columns: Squares = 8
    """Squares along x."""
    rows: Squares = 7
    """Squares along y; one of the two numbers is even, the other odd."""
    square_mm: Annotated[float, Field(ge=1.0, le=200.0)] = 7.0
    """Side of a square."""
    border_mm: Annotated[float, Field(ge=0.01, le=200.0)] = 7.0
    """Width of the blank paper around the squares; detectors need about a square."""
    edge_mm: Annotated[float, Field(ge=0.01, le=100.0)] = 0.4
    """Width of the transition from dark to bright. A ray caster samples a pixel at its centre; the transition stands for the
    pixel's area and the lens's blur, which are about as wide. Corners do not move."""

    def __post_init__(self) -> None:
        if (self.columns + self.rows) % 2 == 0:
            raise InvalidValueError("columns and rows", (self.columns, self.rows), "an even and an odd number")
        if not self.edge_mm <= 0.5 * self.square_mm:
            raise InvalidValueError("edge_mm", self.edge_mm, f"0.01 to {0.5 * self.square_mm:g}, half a square")
        if not self.border_mm >= self.edge_mm:
            raise InvalidValueError("border_mm", self.border_mm, f"edge_mm, {self.edge_mm:g}, to 200")

    @property
    def corner_grid(self) -> tuple[int, int]:
        """Inner corners along x and along y."""
        return self.columns - 1, self.rows - 1

    @property
    def corners(self) -> NDArray[np.float64]:
        """Inner corners in the board's frame, (n, 3) in metres, row by row."""
        across, down = self.corner_grid
        grid_y, grid_x = np.mgrid[:down, :across] * (self.square_mm * _MM)
        return np.column_stack([grid_x.ravel(), grid_y.ravel(), np.zeros(across * down)])

    @property
    def centre(self) -> NDArray[np.float64]:
        """Middle of the board in its frame, (3,), metres."""
        return np.array([0.5 * self.columns - 1.0, 0.5 * self.rows - 1.0, 0.0]) * (self.square_mm * _MM)

    def surface(self) -> BoardSurface:
        """Return the board's triangles.

        Grid lines lie half an edge to either side of each border of ink, so that the albedo, which is interpolated inside a
        triangle, is constant on the squares and a ramp across the edges. A vertex in the middle of each cell keeps the pattern
        symmetric about the corners.
        """
        x, shade_x = self._lines(self.columns)
        y, shade_y = self._lines(self.rows)
        # The signs of the two directions multiply to that of a square; the border's is 0, paper.
        sign = shade_x[:, None] * shade_y
        albedo = np.where(sign > 0.0, _INK, _PAPER)
        i, j = (index.ravel() for index in np.meshgrid(np.arange(len(x) - 1), np.arange(len(y) - 1), indexing="ij"))
        around = ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1))
        points = np.zeros((len(i), 5, 3))
        factor = np.zeros((len(i), 5))
        for corner, (column, row) in enumerate(around):
            points[:, corner, 0], points[:, corner, 1], factor[:, corner] = x[column], y[row], albedo[column, row]
        points[:, 4], factor[:, 4] = points[:, :4].mean(axis=1), factor[:, :4].mean(axis=1)
        first = 5 * np.arange(len(i), dtype=np.int32)[:, None, None]
        # Wound so that the normals point to -z, to the camera.
        fan = np.array([[1, 0, 4], [2, 1, 4], [3, 2, 4], [0, 3, 4]], dtype=np.int32)
        return BoardSurface(points.reshape(-1, 3) * _MM, (first + fan).reshape(-1, 3), factor.ravel())

    def _lines(self, squares: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the lines across one direction in mm, and the sign of the square beside each: 1, -1, ... and 0 outside."""
        borders = (np.arange(squares + 1) - 1.0) * self.square_mm
        half = 0.5 * self.edge_mm
        lines = np.stack([borders - half, borders + half], axis=1).ravel()
        signs = np.concatenate([[0.0], np.repeat((-1.0) ** np.arange(squares), 2), [0.0]])
        outer = np.concatenate([[borders[0] - self.border_mm], lines, [borders[-1] + self.border_mm]])
        return outer, np.concatenate([[0.0], signs, [0.0]])


def blank_card(width_mm: float, height_mm: float) -> BoardSurface:
    """Return a card of the board's paper without ink; axes as the board's, origin in the middle.

    Raises:
        InvalidValueError: If a side lies outside its range.
    """
    check_range("width_mm", width_mm, 1.0, 2000.0)
    check_range("height_mm", height_mm, 1.0, 2000.0)
    corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) * [width_mm * _MM, height_mm * _MM]
    triangles = np.array([[2, 1, 0], [3, 2, 0]], dtype=np.int32)
    return BoardSurface(np.column_stack([corners, np.zeros(4)]), triangles, np.full(4, _PAPER))
