import numpy as np
import pytest

from laploop.errors import InvalidValueError
from laploop.studies.depth.smooth_fill import fill_smoothly

Y, X = np.mgrid[0:24, 0:32].astype(np.float64)
HOLE = (np.abs(Y - 11) < 5) & (np.abs(X - 15) < 6)


def test_hole_in_a_plane_is_filled_with_the_plane():
    plane = 90.0 + 0.3 * X - 0.2 * Y
    filled = fill_smoothly(np.where(HOLE, np.nan, plane), ~HOLE)
    np.testing.assert_allclose(filled, plane, atol=1e-4)  # mm; the touch that keeps the equations solvable


def test_fill_bends_less_than_a_flat_lid_and_less_than_any_change_of_it():
    dome = 100.0 - 0.05 * ((X - 15) ** 2 + (Y - 11) ** 2)
    filled = fill_smoothly(np.where(HOLE, np.nan, dome), ~HOLE)
    # A dome's Laplacian is the same all over, which continues without more bending: it comes back.
    np.testing.assert_allclose(filled, dome, atol=0.2)
    rng = np.random.default_rng(0)
    for _ in range(5):
        assert _bending(filled) < _bending(filled + np.where(HOLE, rng.normal(0.0, 0.01, HOLE.shape), 0.0))


def test_known_pixels_stay_and_nothing_unknown_changes_nothing():
    depth = np.random.default_rng(1).uniform(80.0, 120.0, X.shape)
    np.testing.assert_array_equal(fill_smoothly(depth, np.ones(X.shape, bool)), depth)
    np.testing.assert_array_equal(fill_smoothly(depth, ~HOLE)[~HOLE], depth[~HOLE])


def test_bad_masks_are_refused():
    with pytest.raises(InvalidValueError, match="1 or more"):
        fill_smoothly(X, np.zeros(X.shape, bool))
    with pytest.raises(InvalidValueError, match="finite"):
        fill_smoothly(np.full(X.shape, np.nan), ~HOLE)
    with pytest.raises(InvalidValueError, match="shapes"):
        fill_smoothly(X, HOLE[1:])


def _bending(depth):
    padded = np.pad(depth, 1, mode="edge")
    laplacian = padded[1:-1, :-2] + padded[1:-1, 2:] + padded[:-2, 1:-1] + padded[2:, 1:-1] - 4.0 * depth
    return float(np.sum(laplacian**2))
