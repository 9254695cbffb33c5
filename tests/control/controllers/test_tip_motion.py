from types import SimpleNamespace

import numpy as np
import pytest

from laploop.control.controllers.phase import Phase
from laploop.control.controllers.tip_motion import TipMotion, steady_gain
from laploop.errors import InvalidValueError

MOTION = TipMotion()


def test_way_ends_without_overshoot_at_the_acceleration_that_is_allowed():
    left, speeds = 0.05, []
    while left > 1e-5:
        speed = float(np.linalg.norm(MOTION.towards(np.array([0.0, left, 0.0]))))
        speeds.append(speed)
        left -= 0.001 * speed
    assert left > 0.0
    assert max(speeds) == pytest.approx(0.06)
    assert np.diff(speeds).min() / 0.001 > -0.55  # m/s^2: the gain ends what 0.4 m/s^2 began


def test_return_near_tissue_is_bounded():
    assert np.linalg.norm(MOTION.back(np.array([0.1, 0.0, 0.0]))) == pytest.approx(0.02)
    np.testing.assert_allclose(MOTION.back(np.array([0.001, 0.0, 0.0])), [0.008, 0.0, 0.0])


@pytest.mark.parametrize("lead_ns", [20_000_000, 70_000_000, 200_000_000])
def test_late_loop_neither_rings_nor_overshoots(lead_ns):
    ticks = lead_ns // 1_000_000
    error, sent, errors = 0.01, [0.0] * ticks, []
    for _ in range(3000):
        sent.append(MOTION.gain(lead_ns) * error)
        error -= 0.001 * sent.pop(0)
        errors.append(error)
    assert min(errors) > -0.01 * 0.03  # 3 % of the way
    assert abs(errors[-1]) < 1e-3


def test_prompt_loop_keeps_its_gain():
    assert steady_gain(8.0, 0) == 8.0
    assert steady_gain(8.0, 1_000_000) == 8.0


def test_legs_follow_each_other_and_several_may_be_over_at_once():
    spot = np.array([0.0, 0.0, 0.08])
    geometry = SimpleNamespace(safe_depth=0.09, above=spot, standoff=spot)
    assert MOTION.leg_after(Phase.RISE, spot, geometry) is Phase.READY
    assert MOTION.leg_after(Phase.RISE, spot + [0.0025, 0.0, 0.0], geometry) is Phase.DESCEND
    assert MOTION.leg_after(Phase.RISE, spot + [0.02, 0.0, 0.0], geometry) is Phase.TRAVEL
    assert MOTION.leg_after(Phase.RISE, spot + [0.0, 0.0, 0.02], geometry) is Phase.RISE


def test_bad_speed_is_named():
    with pytest.raises(InvalidValueError, match="max_speed_mps"):
        TipMotion(max_speed_mps=-1.0)
