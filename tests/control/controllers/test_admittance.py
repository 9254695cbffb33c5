import pytest

from laploop.control.controllers.admittance import Admittance

ADMITTANCE = Admittance(gain_mps_per_n=0.08)


def test_speed_is_proportional_to_the_excess_of_force():
    assert ADMITTANCE.lift_mps(0.1, 0) == pytest.approx(0.008)
    assert ADMITTANCE.lift_mps(-0.05, 0) == pytest.approx(-0.004)


def test_speed_is_bounded_both_ways():
    assert ADMITTANCE.lift_mps(10.0, 0) == 0.030
    assert ADMITTANCE.lift_mps(-10.0, 0) == -0.006


def test_late_arm_lowers_the_gain_to_what_is_steady_on_the_stiffest_tissue():
    # 0.4 / (0.1 s 300 N/m) m/s a newton.
    assert ADMITTANCE.lift_mps(0.1, 100_000_000) == pytest.approx(0.04 / 30.0)
