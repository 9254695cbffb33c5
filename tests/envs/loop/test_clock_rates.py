import pytest

from laploop.envs.loop.clock_rates import ClockRates
from laploop.errors import InvalidValueError


def test_default_periods_are_whole_multiples_of_the_physics_step():
    rates = ClockRates()
    assert rates.physics_steps_per_control == 4
    assert rates.camera_ns % rates.physics_ns == 0
    assert rates.control_s == pytest.approx(0.008)


@pytest.mark.parametrize(("name", "value"), [("control_ns", 7_000_000), ("camera_ns", 33_333_333), ("control_ns", 0)])
def test_a_period_that_is_not_a_multiple_is_refused_and_not_rounded(name, value):
    with pytest.raises(InvalidValueError, match=f"{name} is {value}.*multiple of physics_ns"):
        ClockRates(**{name: value})


def test_a_camera_at_32_ms_fits_the_clock():
    assert ClockRates(camera_ns=32_000_000).camera_ns == 32_000_000
