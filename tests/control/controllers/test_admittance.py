import pytest

from laploop.control.controllers.admittance import Admittance, AdmittanceConfig


def proportional():
    return Admittance(AdmittanceConfig(gain_mps_per_n=0.08))


def test_speed_is_proportional_to_the_excess_of_force():
    assert proportional().lift_mps(0.1, 0, 0.008) == pytest.approx(0.008)
    assert proportional().lift_mps(-0.05, 0, 0.008) == pytest.approx(-0.004)


def test_speed_is_bounded_both_ways():
    assert proportional().lift_mps(10.0, 0, 0.008) == 0.030
    assert proportional().lift_mps(-10.0, 0, 0.008) == -0.006


def test_late_arm_lowers_the_gain_to_what_is_steady_on_the_stiffest_tissue():
    # 0.4 / (0.1 s 300 N/m) m/s a newton.
    assert proportional().lift_mps(0.1, 100_000_000, 0.008) == pytest.approx(0.04 / 30.0)


def pressed(admittance, *, stiffness_n_m, tissue_mps, seconds=2.0, wanted_n=0.04, step_s=0.001):
    """Return the force at the end on a spring whose surface moves towards the tip."""
    force = wanted_n
    for _ in range(round(seconds / step_s)):
        lift = admittance.lift_mps(force - wanted_n, 0, step_s)
        force = max(force + stiffness_n_m * (tissue_mps - lift) * step_s, 0.0)
    return force


@pytest.mark.parametrize("tissue_mps", [0.002, -0.002])
def test_the_integral_removes_what_a_surface_that_moves_on_leaves_of_the_force(tissue_mps):
    both = Admittance(AdmittanceConfig(gain_mps_per_n=0.08, integral_per_s=6.0))
    # Newtons: 0.002 m/s over 0.08 m/s a newton is what the proportional part alone needs.
    assert pressed(proportional(), stiffness_n_m=200.0, tissue_mps=tissue_mps) == pytest.approx(0.04 + tissue_mps / 0.08)
    assert pressed(both, stiffness_n_m=200.0, tissue_mps=tissue_mps) == pytest.approx(0.04, abs=2e-4)


def test_the_integral_does_not_wind_up_and_is_forgotten():
    admittance = Admittance(AdmittanceConfig(gain_mps_per_n=0.08, integral_per_s=6.0))
    for _ in range(10_000):
        admittance.lift_mps(-1.0, 0, 0.008)
    # From the bound of 6 mm/s back through zero at 6/s times 0.08 m/s a newton.
    assert admittance.lift_mps(0.2, 0, 0.008) == pytest.approx(0.016 - 0.006 + 6.0 * 0.008 * 0.016)
    admittance.reset()
    assert admittance.lift_mps(0.0, 0, 0.008) == 0.0


def test_a_late_arm_gets_a_slower_integral():
    late = Admittance(AdmittanceConfig(gain_mps_per_n=0.08, integral_per_s=6.0))
    gain = 0.04 / 30.0 / 0.1
    late.lift_mps(0.1, 100_000_000, 1.0)
    # Two fifths of the loop's rate, gain times 300 N/m.
    assert late.lift_mps(0.0, 100_000_000, 0.0) == pytest.approx(0.4 * gain * 300.0 * gain * 0.1)
