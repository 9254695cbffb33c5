import numpy as np
import pytest

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


def test_uncertainty_grows_with_the_time_ahead_and_with_process_noise():
    quiet, noisy = make(), make()
    quiet.advance(FRAME_NS)
    noisy.advance(FRAME_NS, process_noise_scale=100.0)
    assert quiet.outlook(FRAME_NS)[1] < quiet.outlook(10 * FRAME_NS)[1]
    assert quiet.outlook(FRAME_NS)[1] < noisy.outlook(FRAME_NS)[1]


def test_impossible_noise_is_refused():
    with pytest.raises(InvalidValueError, match="measurement_ceiling_m"):
        HarmonicNoise(measurement_floor_m=0.001, measurement_ceiling_m=0.0005)
    with pytest.raises(InvalidValueError, match="frequency"):
        HarmonicNoise(frequency=-0.1)
