import numpy as np
import pytest

from laploop.assets.calibration_board import CalibrationBoard
from laploop.errors import InvalidValueError


@pytest.fixture(scope="module")
def board():
    return CalibrationBoard()


def albedo_at(board, x_mm, y_mm):
    """Albedo interpolated in the triangle under each point of the board, as a ray caster does it."""
    surface = board.surface()
    triangles = 1e3 * surface.points[surface.triangles][..., :2]
    points = np.column_stack([x_mm, y_mm])
    a, b, c = np.moveaxis(triangles, 1, 0)
    area = np.linalg.det(np.stack([b - a, c - a], axis=-1))
    weights = np.stack(
        [
            np.linalg.det(np.stack(np.broadcast_arrays(q - points[:, None], r - points[:, None]), axis=-1)) / area
            for q, r in ((b, c), (c, a), (a, b))
        ],
        axis=-1,
    )
    inside = weights.min(axis=-1)
    found = inside.argmax(axis=1)
    rows = np.arange(len(points))
    assert (inside[rows, found] > -1e-9).all()  # every point lies on a triangle
    return (weights[rows, found] * surface.albedo_factor[surface.triangles[found]]).sum(axis=1)


def test_triangles_face_the_camera_and_cover_the_board_once(board):
    surface = board.surface()
    corners = surface.points[surface.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] < 0.0).all()
    width, height, _ = np.ptp(surface.points, axis=0)
    assert (width, height) == pytest.approx((0.070, 0.063))  # 8 x 7 squares of 7 mm and 7 mm of border
    assert -0.5 * normals[:, 2].sum() == pytest.approx(width * height, rel=1e-9)
    middle = 0.5 * (surface.points.min(axis=0) + surface.points.max(axis=0))
    np.testing.assert_allclose(board.centre, middle, atol=1e-12)


def test_squares_alternate_from_a_dark_one_left_above_the_first_corner(board):
    column, row = (index.ravel() for index in np.mgrid[: board.columns, : board.rows])
    seen = albedo_at(board, 7.0 * column - 3.5, 7.0 * row - 3.5)
    np.testing.assert_allclose(seen, np.where((column + row) % 2 == 0, 0.1, 1.0), atol=1e-9)
    opposite = albedo_at(board, [7.0 * 7 - 3.5], [7.0 * 6 - 3.5])
    assert opposite[0] == pytest.approx(1.0)  # half a turn shows in a picture


def test_border_is_blank(board):
    x = np.linspace(-13.5, 55.5, 40)
    for y in (-10.0, 45.0):
        np.testing.assert_allclose(albedo_at(board, x, np.full(40, y)), 1.0, atol=1e-9)


def test_pattern_is_point_symmetric_about_every_corner(board):
    rng = np.random.default_rng(0)
    offset = rng.uniform(-0.3, 0.3, (board.corners.shape[0], 2))
    corners = 1e3 * board.corners[:, :2]
    here, there = (albedo_at(board, *(corners + sign * offset).T) for sign in (1.0, -1.0))
    np.testing.assert_allclose(here, there, atol=1e-9)
    np.testing.assert_allclose(albedo_at(board, *corners.T), 0.55, atol=1e-9)


def test_corners_are_listed_row_by_row(board):
    assert board.corner_grid == (7, 6)
    assert board.corners.shape == (42, 3)
    np.testing.assert_allclose(board.corners[[0, 1, 7, 41]], [[0, 0, 0], [0.007, 0, 0], [0, 0.007, 0], [0.042, 0.035, 0]])


@pytest.mark.parametrize(
    ("field", "value"),
    [("columns", 3), ("rows", 41), ("square_mm", 0.5), ("border_mm", 0.1), ("edge_mm", 3.6), ("edge_mm", 0.0)],
)
def test_fields_out_of_range_are_refused(field, value):
    with pytest.raises(InvalidValueError, match=field):
        CalibrationBoard(**{field: value})


def test_a_board_that_looks_the_same_upside_down_is_refused():
    with pytest.raises(InvalidValueError, match="an even and an odd"):
        CalibrationBoard(columns=8, rows=6)
