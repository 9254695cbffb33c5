import pytest

from laploop.envs.theatre.clock_rates import ClockRates
from laploop.errors import InvalidValueError


def test_default_periods_are_whole_multiples_of_the_physics_step():
    rates = ClockRates()
    assert (rates.physics_ns, rates.control_ns, rates.camera_ns) == (2_000_000, 8_000_000, 40_000_000)
    assert rates.physics_steps_per_control == 4
    assert rates.control_s == pytest.approx(0.008)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("camera_hz", 30.0, r"whole physics steps of 2 ms; the nearest are 29.412 or 31.25 Hz"),
        ("control_hz", 120.0, r"the nearest are 100 or 125 Hz"),
        ("control_hz", 600.0, r"the nearest are 250 or 500 Hz"),
        ("physics_hz", 300.0, "a whole number of nanoseconds"),
        ("camera_hz", 0.0, r"0\.5 to 1000"),
        ("camera_hz", float("nan"), r"0\.5 to 1000"),
        ("physics_hz", "500", "200 to 5000"),
    ],
)
def test_a_rate_that_does_not_fit_is_refused_and_not_rounded(name, value, message):
    with pytest.raises(InvalidValueError, match=f"{name} is .*{message}"):
        ClockRates(**{name: value})


@pytest.mark.parametrize(("hertz", "period_ns"), [(31.25, 32_000_000), (50.0, 20_000_000), (1e3 / 34.0, 34_000_000)])
def test_cameras_whose_period_is_whole_physics_steps_fit(hertz, period_ns):
    assert ClockRates(camera_hz=hertz).camera_ns == period_ns
