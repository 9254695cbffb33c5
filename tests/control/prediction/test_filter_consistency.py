"""What is kept of a filter's innovations and forecasts, and what follows from it."""

import numpy as np
import pytest

from laploop.control.prediction.filter_consistency import FilterConsistency
from laploop.control.prediction.harmonic_filter import HarmonicFilter, HarmonicNoise
from laploop.control.prediction.harmonic_model import HarmonicModel

FRAME_NS = 40_000_000


def swing(time_ns):
    return 0.005 * np.cos(2.0 * np.pi * 1.05 * time_ns * 1e-9)


def record_of(*, horizon=3, window=10):
    """Return an empty record of a filter that starts where `swing` does."""
    filtered = HarmonicFilter(
        HarmonicModel((1,)),
        HarmonicNoise(),
        time_ns=0,
        state=np.array([0.0, 2.0 * np.pi * 1.05, 0.005, 0.0]),
        covariance=np.diag([1e-6, 0.1, 1e-6, 1e-6]),
        bounds_rad_s=2.0 * np.pi * np.array([[0.9, 1.1]]),
        measurement_sigma_m=0.0001,
    )
    return FilterConsistency(filtered, horizon_ns=horizon * FRAME_NS, window=window)


def feed(record, frames, *, bias=0.0):
    for k in frames:
        record.advance(k * FRAME_NS)
        record.correct(swing(k * FRAME_NS) + bias)


def test_an_empty_record_gives_no_grounds_for_trust():
    record = record_of()
    assert record.forecasts == 0
    assert [record.mean_nis, record.forecast_variance, record.held_variance] == [np.inf] * 3
    assert record.recent_forecast_variance(5) == np.inf


def test_forecasts_are_held_against_what_came():
    record = record_of()
    feed(record, range(1, 60))
    held = [swing(k * FRAME_NS) - swing((k - 3) * FRAME_NS) for k in range(50, 60)]
    assert record.forecasts == 10
    assert record.held_variance == pytest.approx(np.mean(np.square(held)), rel=1e-9)
    assert record.forecast_variance < 1e-3 * record.held_variance


def test_what_came_between_two_measurements_is_interpolated():
    record = record_of(horizon=1.5)
    feed(record, range(1, 4))
    came = [0.5 * (swing(k * FRAME_NS) + swing((k + 1) * FRAME_NS)) for k in (2,)]
    assert record.held_variance == pytest.approx((swing(FRAME_NS) - came[0]) ** 2, rel=1e-9)


def test_a_forecast_for_a_time_without_measurements_around_it_is_dropped():
    record = record_of()
    feed(record, [1])
    record.shift(0.0, 0.0)  # forgets the measurement before
    feed(record, [20, 21])
    assert record.forecasts == 0


def test_the_window_bounds_the_record_and_its_end_counts_alone():
    record = record_of(window=5)
    feed(record, range(1, 30))
    assert record.forecasts == 5
    assert record.recent_forecast_variance(5) == record.forecast_variance
    assert record.recent_forecast_variance(1) == record._forecast_squares[-1]


def test_innovations_of_a_filter_that_is_right_about_itself_are_about_one():
    record, rng = record_of(window=800), np.random.default_rng(0)
    for k in range(1, 1000):
        record.advance(k * FRAME_NS)
        record.correct(swing(k * FRAME_NS) + 0.0002 * rng.standard_normal())
    # The walks allowed for are larger than the stationary truth, so a little below 1; 0.1 are two standard errors.
    assert 0.7 < record.mean_nis < 1.1


def test_large_innovations_raise_the_process_noise_until_the_filter_is_consistent_again():
    record = record_of()
    feed(record, range(1, 100))
    before = record.filter.innovation(0.0)[1]
    feed(record, range(100, 103), bias=0.003)
    record.advance(103 * FRAME_NS)
    assert record.filter.innovation(0.0)[1] > 2.0 * before
    feed(record, range(103, 200))
    record.advance(200 * FRAME_NS)
    assert record.filter.innovation(0.0)[1] < 1.5 * before


def test_a_step_of_the_bias_clears_the_record():
    record = record_of()
    feed(record, range(1, 20))
    before = record.filter.state[0]
    record.shift(0.01, 0.001)
    assert record.forecasts == 0
    assert record.mean_nis == np.inf
    assert record.filter.state[0] == pytest.approx(before + 0.01)
