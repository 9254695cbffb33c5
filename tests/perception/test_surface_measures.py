"""Closed forms: planes seen by a pinhole."""

import numpy as np
import pytest

from laploop.errors import InvalidValueError
from laploop.perception.geometry import Intrinsics
from laploop.perception.metrics import DepthErrors
from laploop.perception.surface_measures import EDGE_PX, TrueSurface, with_neighbours

K = Intrinsics(width=60, height=50, fx=55.0, fy=52.0, cx=31.0, cy=24.0)
EVERYWHERE = np.ones((50, 60), bool)


def plane(normal, distance_mm=100.0):
    """Depth of the plane through (0, 0, distance) with a normal (3,)."""
    return (distance_mm * normal[2] / (K.rays @ np.asarray(normal, float))).astype(np.float32)


def tilted(angle_deg, turn_deg=0.0):
    angle, turn = np.radians([angle_deg, turn_deg])
    return np.array([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)])


def scores(estimate, truth, mask=EVERYWHERE):
    errors = DepthErrors()
    errors.add(estimate, truth, mask)
    errors.add_surface(TrueSurface(truth, K).compare(estimate), estimate - truth, mask)
    return errors.metrics()


def test_angle_between_two_planes_is_that_of_their_normals():
    found = scores(plane(tilted(35.0, 20.0)), plane(tilted(10.0, 20.0)))
    assert found.normal_deg == pytest.approx(25.0, abs=0.5)  # central differences bend where depth is far from linear
    assert scores(plane(tilted(10.0)), plane(tilted(10.0))).normal_deg == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 45.0])
def test_distance_to_the_plane_is_shorter_than_the_error_of_depth_on_a_slope(angle_deg):
    normal = tilted(angle_deg)
    truth = plane(normal)
    # A parallel plane 2 mm further along the normal.
    estimate = plane(normal, 100.0 + 2.0 / normal[2])
    found = scores(estimate, truth)
    assert found.plane_mm == pytest.approx(2.0, rel=0.01)
    assert found.mae_mm > found.plane_mm - 1e-3


def test_a_step_has_edges_on_both_sides_and_no_normals_across():
    truth = np.full((50, 60), 100.0, np.float32)
    truth[:, 30:] = 104.0
    surface = TrueSurface(truth, K)
    assert np.flatnonzero(surface.edge[20]).tolist() == list(range(29 - EDGE_PX, 31 + EDGE_PX))
    assert np.flatnonzero(~surface.smooth[20]).tolist() == [0, 29, 30, 59]
    small = np.where(truth > 100.0, np.float32(102.9), truth)
    assert not TrueSurface(small, K).edge.any()


def test_errors_at_edges_are_apart_from_those_away():
    truth = np.full((50, 60), 100.0, np.float32)
    truth[:, 30:] = 110.0
    estimate = truth.copy()
    estimate[:, 26:34] += 5.0
    estimate[:, :10] -= 1.0
    found = scores(estimate, truth)
    assert found.edge_mae_mm == pytest.approx(5.0)
    assert found.away_mae_mm == pytest.approx(10 / 52)
    flat = scores(truth[:, :1] + np.zeros((50, 60), np.float32), np.full((50, 60), 100.0, np.float32))
    assert np.isnan(flat.edge_mae_mm)
    assert flat.away_mae_mm == 0.0


def test_what_is_not_there_is_neither_a_step_nor_smooth():
    truth = np.full((50, 60), 100.0, np.float32)
    truth[10:20, 10:20] = np.nan
    surface = TrueSurface(truth, K)
    assert not surface.edge.any()
    assert not surface.smooth[9, 15]
    assert surface.smooth[8, 15]
    found = scores(np.full((50, 60), 101.0, np.float32), truth, np.isfinite(truth))
    assert found.plane_mm == pytest.approx(1.0)


def test_normals_count_only_where_the_neighbours_count_too():
    mask = np.zeros((50, 60), bool)
    mask[20:23, 20:23] = True
    assert np.argwhere(with_neighbours(mask)).tolist() == [[21, 21]]
    truth = np.full((50, 60), 100.0, np.float32)
    estimate = np.full((50, 60), 5.0, np.float32)
    estimate[20:23, 20:23] = 100.0
    assert scores(estimate, truth, mask).normal_deg == pytest.approx(0.0, abs=1e-4)


def test_another_size_is_refused():
    with pytest.raises(InvalidValueError, match=r"\(50, 60\), the camera's"):
        TrueSurface(np.ones((60, 50), np.float32), K)
