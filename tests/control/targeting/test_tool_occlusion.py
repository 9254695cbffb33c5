import numpy as np
import pytest

from laploop.assets.shafts import INSTRUMENT
from laploop.control.targeting.tool_occlusion import ToolOutline, hidden_by_tool
from laploop.errors import InvalidValueError

CAMERA = np.zeros((1, 3))
TIP = np.array([0.0, 0.0, 0.08])
TROCAR = np.array([0.15, 0.0, -0.1])


def plane_points(x, y, z=0.1):
    x = np.atleast_1d(x)
    return np.stack([x, np.full_like(x, y), np.full_like(x, z)], axis=-1)


def test_radius_grows_from_ball_to_shaft():
    outline = ToolOutline(margin_m=0.0)
    radius = outline.radius(np.array([0.0, 0.010, 0.017, 0.024, 0.3]))
    np.testing.assert_allclose(radius, [0.0015, 0.0015, 0.002, 0.0025, 0.0025], atol=1e-12)  # metres, rounding


def test_points_behind_the_ball_are_hidden_as_far_as_its_projected_edge():
    outline = ToolOutline(margin_m=0.0)
    # The ball's silhouette, seen from the origin, is a cone; across the shaft's direction it is exact.
    edge = 0.1 * np.tan(np.arcsin(INSTRUMENT.tip_radius_m / 0.08))
    points = np.stack([np.zeros(2), [edge - 1e-5, edge + 1e-5], [0.1, 0.1]], axis=-1)
    np.testing.assert_array_equal(hidden_by_tool(points, TIP, TROCAR, CAMERA, outline), [True, False])


def test_shaft_hides_what_lies_behind_it_and_nothing_on_the_other_side():
    points = plane_points(np.array([0.03, 0.06, -0.01, -0.03]), 0.0)
    np.testing.assert_array_equal(hidden_by_tool(points, TIP, TROCAR, CAMERA, ToolOutline()), [True, True, False, False])


def test_points_in_front_of_the_tool_are_seen():
    points = np.array([[0.0, 0.0, 0.07]])
    assert not hidden_by_tool(points, TIP, TROCAR, CAMERA, ToolOutline())[0]


def test_projector_to_the_right_casts_the_balls_shadow_to_its_left():
    projector = np.array([[0.005, 0.0, 0.0]])
    outline = ToolOutline(margin_m=0.0)
    shadow = plane_points(TIP[0] - (0.005 - TIP[0]) * 0.02 / 0.08, 0.0)
    beside = plane_points(-0.0045, 0.0)
    assert hidden_by_tool(shadow, TIP, TROCAR, projector, outline)[0]
    assert not hidden_by_tool(beside, TIP, TROCAR, projector, outline)[0]


def test_distances_match_a_brute_force_search():
    rng = np.random.default_rng(0)
    points = rng.uniform([-0.03, -0.03, 0.08], [0.03, 0.03, 0.11], (60, 3))
    eyes = np.array([[0.0, 0.0, 0.0], [0.005, 0.0, 0.0]])
    outline = ToolOutline(margin_m=0.003)
    s, t = np.linspace(0.0, 1.0, 251), np.linspace(0.0, 1.0, 501)
    axis = TIP + t[:, None] * (TROCAR - TIP)
    expected = np.zeros(len(points), dtype=bool)
    doubtful = np.zeros(len(points), dtype=bool)
    for k, point in enumerate(points):
        for eye in eyes:
            sight = eye + s[:, None] * (point - eye)
            distance = np.linalg.norm(sight[:, None, :] - axis[None, :, :], axis=-1)
            nearest = int(np.argmin(distance.min(axis=0)))
            spare = distance.min() - outline.radius(np.array([t[nearest] * np.linalg.norm(TROCAR - TIP)]))[0]
            expected[k] |= spare < 0.0
            doubtful[k] |= abs(spare) < 4e-4  # metres, the grid's resolution
    hidden = hidden_by_tool(points, TIP, TROCAR, eyes, outline)
    np.testing.assert_array_equal(hidden[~doubtful], expected[~doubtful])
    assert 5 < np.count_nonzero(expected) < 55


@pytest.mark.parametrize(("field", "value"), [("neck_m", -0.1), ("margin_m", -0.1), ("taper_m", 0.0)])
def test_bad_outline_names_the_field(field, value):
    with pytest.raises(InvalidValueError, match=field):
        ToolOutline(**{field: value})
