"""The last millimetres over a plane at rest; the tip follows its velocity at once."""

from types import SimpleNamespace

import numpy as np
import pytest

from laploop.control.controllers.guarded_move import GuardedMove, GuardedMoveConfig
from laploop.control.controllers.tip_motion import TipMotion

CONFIG = GuardedMoveConfig()
PERIOD_S = 0.008
AXIS = np.array([0.6, 0.0, -0.8])
RAY = np.array([0.0, 0.6, 0.8])
NORMAL = np.array([0.0, 0.0, -1.0])
SEEN = np.array([0.01, -0.02, 0.1])


@pytest.fixture
def move():
    move = GuardedMove(CONFIG, TipMotion())
    move.height = 0.004
    return move


def geometry(move):
    """Return what the approach would lay out: the goal moves along the ray by the shift."""
    return SimpleNamespace(goal=SEEN + move.shift * RAY, axis=AXIS, ray=RAY, normal=NORMAL)


def state(tip):
    return SimpleNamespace(tip_in_camera=np.asarray(tip), lead_ns=0)


def descended(move, seconds):
    """Follow the move; return where the tip is, (3,), and the largest speed."""
    tip, fastest = SEEN + move.height * AXIS, 0.0
    for _ in range(round(seconds / PERIOD_S)):
        velocity = move.descend(state(tip), geometry(move), PERIOD_S)
        fastest = max(fastest, float(np.linalg.norm(velocity)))
        tip = tip + PERIOD_S * velocity
    return tip, fastest


def test_it_comes_down_along_the_axis_at_the_speed_of_approach(move):
    tip, fastest = descended(move, 0.2)
    np.testing.assert_allclose(tip, SEEN + 0.002 * AXIS, atol=1e-6)  # metres: 10 mm/s for 0.2 s
    assert fastest == pytest.approx(CONFIG.approach_speed_mps, rel=1e-6)


def test_beyond_the_seen_surface_it_searches_along_the_ray_and_then_rests(move):
    tip, _ = descended(move, 1.5)
    assert move.height == 0.0
    assert move.shift == pytest.approx(CONFIG.search_m, abs=CONFIG.approach_speed_mps * PERIOD_S)
    np.testing.assert_allclose(tip, SEEN + move.shift * RAY, atol=1e-5)  # metres


def test_the_reference_waits_for_a_tip_that_is_far_behind(move):
    far = SEEN + 0.004 * AXIS + [0.0025, 0.0, 0.0]
    velocity = move.descend(state(far), geometry(move), PERIOD_S)
    assert move.height == 0.004
    np.testing.assert_allclose(velocity / np.linalg.norm(velocity), [-1.0, 0.0, 0.0], atol=1e-12)


def test_a_touch_high_above_the_seen_surface_is_one_of_an_obstacle(move):
    assert not move.too_early
    move.height = CONFIG.early_contact_m + 1e-4
    assert move.too_early


@pytest.mark.parametrize("error", [-0.002, 0.001, 0.003])
def test_a_touch_puts_the_seen_surface_where_the_felt_one_is_but_for_the_slack(move, error):
    # The plane lies farther along the ray than seen; the tip rests on it, somewhere beside the target.
    felt = SEEN + error * RAY + [0.001, 0.0, 0.0]
    move.feel(state(felt), geometry(move), fraction=1.0)
    slack = np.copysign(CONFIG.contact_slack_m / (RAY @ -NORMAL), error)
    assert move.shift == pytest.approx(error - slack, abs=1e-12)


def test_a_touch_within_the_slack_corrects_nothing(move):
    move.feel(state(SEEN + [0.0, 0.0, 0.9 * CONFIG.contact_slack_m]), geometry(move), fraction=1.0)
    assert move.shift == 0.0


def test_a_fraction_of_a_correction_adds_up_over_ticks(move):
    felt = SEEN + 0.002 * RAY
    shifts = []
    for _ in range(200):
        move.feel(state(felt), geometry(move), fraction=0.05)
        shifts.append(move.shift)
    assert np.diff(shifts).min() >= 0.0
    assert shifts[0] == pytest.approx(0.05 * shifts[-1], rel=1e-3)


def test_the_correction_is_bounded(move):
    move.feel(state(SEEN + 0.05 * RAY), geometry(move), fraction=1.0)
    assert move.shift == CONFIG.early_contact_m
    move.feel(state(SEEN - 0.05 * RAY), geometry(move), fraction=1.0)
    assert move.shift == -CONFIG.early_contact_m


def test_a_ray_that_grazes_the_surface_gives_no_unbounded_shift(move):
    grazing = geometry(move)
    grazing.ray = np.array([0.9998, 0.0, 0.02])
    move.feel(state(SEEN + [0.0, 0.0, 0.00065]), grazing, fraction=1.0)
    assert move.shift == pytest.approx(0.0004 / 0.3)  # metres: no cosine below 0.3 counts
