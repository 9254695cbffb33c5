import numpy as np
import pytest

from laploop.control.prediction.filter_consistency import FilterConsistency
from laploop.control.prediction.harmonic_filter import HarmonicFilter, HarmonicNoise
from laploop.control.prediction.harmonic_model import HarmonicModel
from laploop.errors import InvalidValueError

FRAME_NS = 40_000_000


def make(*, hertz=1.0, amplitude=0.005):
    model = HarmonicModel((1,))
    return HarmonicFilter(
        model,
        HarmonicNoise(),
        time_ns=0,
        state=np.array([0.0, 2.0 * np.pi * hertz, amplitude, 0.0]),
        covariance=np.diag([1e-6, 0.1, 1e-6, 1e-6]),
        bounds_rad_s=2.0 * np.pi * np.array([[0.9, 1.1]]),
        measurement_sigma_m=0.0001,
    )


def swing(time_ns, hertz=1.05):
    return 0.005 * np.cos(2.0 * np.pi * hertz * time_ns * 1e-9)


def test_filter_is_right_about_itself():
    rng = np.random.default_rng(0)
    filtered = make()
    squares = []
    for k in range(1, 1000):
        filtered.advance(k * FRAME_NS)
        squares.append(filtered.correct(swing(k * FRAME_NS) + 0.0002 * rng.standard_normal()))
    # The walks allowed for are larger than the stationary truth, so a little below 1; 0.1 are two standard errors.
    assert 0.7 < np.mean(squares[200:]) < 1.1
    assert filtered.measurement_sigma_m == pytest.approx(0.0002, rel=0.15)
    assert filtered.frequencies_hz[0] == pytest.approx(1.05, rel=0.01)


def test_frequency_stays_within_its_bounds():
    filtered = make()
    for k in range(1, 200):
        filtered.advance(k * FRAME_NS)
        filtered.correct(swing(k * FRAME_NS, hertz=1.4))
        assert 0.9 - 1e-12 <= filtered.frequencies_hz[0] <= 1.1 + 1e-12
    assert np.isfinite(filtered.state).all()


def test_uncertainty_grows_with_the_time_ahead_and_with_unrest():
    calm, restless = make(), make()
    calm.advance(FRAME_NS)
    restless.advance(FRAME_NS, process_noise_scale=100.0)
    assert calm.outlook(FRAME_NS)[1] < calm.outlook(10 * FRAME_NS)[1]
    assert calm.outlook(FRAME_NS)[1] < restless.outlook(FRAME_NS)[1]


def test_forecasts_are_held_against_what_came():
    record = FilterConsistency(make(hertz=1.05), horizon_ns=3 * FRAME_NS, window=10)
    assert record.forecasts == 0
    assert np.isinf(record.forecast_variance)
    for k in range(1, 60):
        record.advance(k * FRAME_NS)
        record.correct(swing(k * FRAME_NS))
    held = [swing(k * FRAME_NS) - swing((k - 3) * FRAME_NS) for k in range(50, 60)]
    assert record.forecasts == 10
    assert record.held_variance == pytest.approx(np.mean(np.square(held)), rel=1e-9)
    assert record.forecast_variance < 1e-3 * record.held_variance


def test_a_step_of_the_bias_clears_the_record():
    record = FilterConsistency(make(), horizon_ns=3 * FRAME_NS, window=10)
    for k in range(1, 20):
        record.advance(k * FRAME_NS)
        record.correct(swing(k * FRAME_NS))
    before = record.filter.state[0]
    record.shift(0.01, 0.001)
    assert record.forecasts == 0
    assert record.filter.state[0] == pytest.approx(before + 0.01)


def test_impossible_noise_is_refused():
    with pytest.raises(InvalidValueError, match="measurement_ceiling_m"):
        HarmonicNoise(measurement_floor_m=0.001, measurement_ceiling_m=0.0005)
    with pytest.raises(InvalidValueError, match="frequency"):
        HarmonicNoise(frequency=-0.1)
