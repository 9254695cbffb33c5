import numpy as np
import pytest

from laploop.studies.sweeps.analyses.delay_margin import crossing
from laploop.studies.sweeps.analyses.delay_theory import border_gain_per_s, following_rms_m, overshoot_percent, pure_delay_rms_m


def test_a_delayed_sine_differs_by_twice_the_sine_of_half_the_phase():
    times = np.arange(0.0, 40.0, 0.001)
    apart = 0.005 * (np.sin(0.5 * np.pi * times) - np.sin(0.5 * np.pi * (times - 0.3)))
    assert pure_delay_rms_m([(0.005, 0.25)], 0.3) == pytest.approx(np.sqrt(np.mean(apart**2)), rel=1e-6)


def test_the_follower_matches_a_simulated_one():
    step, gain, lost = 0.001, 8.0, 0.0
    errors, place = [], 0.0
    for number in range(40_000):
        now = number * step
        seen = 0.04 * np.floor((now - 0.1) / 0.04 + 1e-9)
        place += step * gain * (0.005 * np.sin(0.5 * np.pi * seen) - place)
        errors.append(0.005 * np.sin(0.5 * np.pi * (now + step)) - place)
    lost = np.sqrt(np.mean(np.square(errors[8000:])))
    assert following_rms_m([(0.005, 0.25)], 0.1, 0.04, gain) == pytest.approx(lost, rel=0.01)


@pytest.mark.parametrize("frames", [0, 1, 2, 3])
def test_the_border_parts_decay_from_growth(frames):
    for factor in (0.99, 1.01):
        past = [1.0] * (frames + 1)
        for _ in range(3000):
            past.append(past[-1] - factor * border_gain_per_s(frames, 0.04) * 0.04 * past[-1 - frames])
        assert (max(map(abs, past[-50:])) > 2.0) == (factor > 1.0)


@pytest.mark.parametrize(("product", "percent"), [(0.2, 0.0), (0.5, 4.1), (0.7, 20.6), (1.0, 50.0)])
def test_overshoot(product, percent):
    assert overshoot_percent(product) == pytest.approx(percent, abs=0.06)


def test_the_crossing_lies_in_proportion_between_neighbours():
    assert crossing([20.0, 24.0, 28.0], [-3.0, -1.0, 3.0]) == pytest.approx(25.0)
    assert crossing([20.0, 24.0], [-3.0, None]) is None
