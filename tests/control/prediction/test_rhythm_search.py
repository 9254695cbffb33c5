import copy
import pickle

import numpy as np
import pytest

from laploop.control.prediction.rhythm_search import RhythmBand, RhythmSearch, RhythmSearchConfig
from laploop.control.prediction.sample_window import SampleWindow
from laploop.errors import InvalidValueError


def found_in(signal, *, seconds=10.0, noise=0.0001):
    window = SampleWindow(span_s=10.0, spacing_s=0.03)
    rng = np.random.default_rng(0)
    for k in range(round(seconds / 0.04)):
        window.add(k * 40_000_000, float(signal(k * 0.04)) + noise * rng.standard_normal())
    search = RhythmSearch(RhythmSearchConfig(), window)
    for _ in range(100):
        found = search.step()
        if found is not None:
            return found
    raise AssertionError("the search does not end")


def wave(amplitude, hertz, phase=0.0):
    return lambda time_s: amplitude * np.sin(2.0 * np.pi * hertz * time_s + phase)


@pytest.mark.parametrize("breath_hz", [0.17, 0.25, 0.41, 0.58])
@pytest.mark.parametrize("beat_hz", [0.8, 1.3, 2.45])
def test_both_frequencies_are_found_in_ten_seconds(breath_hz, beat_hz):
    breath, beat = wave(0.005, breath_hz, 1.0), wave(0.0005, beat_hz, 2.0)
    found = found_in(lambda time_s: 0.1 + breath(time_s) + beat(time_s))
    np.testing.assert_allclose(found.state[found.model.rates] / (2.0 * np.pi), [breath_hz, beat_hz], rtol=0.02)
    assert found.state[0] == pytest.approx(0.1, abs=2e-4)  # metres
    assert found.residual_m == pytest.approx(0.0001, rel=0.2)


def test_respiration_is_not_taken_for_half_its_frequency():
    def paused(time_s):
        return 0.01 * np.cos(np.pi * 0.4 * time_s) ** 6

    found = found_in(paused)
    assert found.state[found.model.rates][0] / (2.0 * np.pi) == pytest.approx(0.4, rel=0.01)


def test_noise_is_no_rhythm():
    found = found_in(lambda time_s: 0.0 * time_s, noise=0.0003)
    assert found.model.harmonics == ()
    assert found.residual_m == pytest.approx(0.0003, rel=0.15)


def test_covariance_covers_the_errors_of_the_phasors():
    breath = wave(0.005, 0.25)
    found = found_in(breath, noise=0.0003)
    truth = np.zeros(found.model.size)
    truth[found.model.rates] = 2.0 * np.pi * 0.25
    at = found.time_ns * 1e-9
    # sin(w t + p) is the real part of exp(i (w t + p - pi / 2)).
    phasor = 0.005 * np.exp(1j * (2.0 * np.pi * 0.25 * at - np.pi / 2.0))
    truth[found.model.real[0]], truth[found.model.imaginary[0]] = phasor.real, phasor.imag
    error = found.state - truth
    distance = error @ np.linalg.solve(found.covariance, error)
    assert distance < 3.0 * found.model.size


def test_nothing_is_sought_in_too_short_a_signal():
    window = SampleWindow(span_s=10.0, spacing_s=0.03)
    search = RhythmSearch(RhythmSearchConfig(), window)
    for k in range(70):
        window.add(k * 40_000_000, 0.0)
        assert search.step() is None


def test_bands_must_not_overlap():
    band = RhythmBand(lowest_hz=0.1, highest_hz=0.8, harmonics=2, step_hz=0.02)
    with pytest.raises(InvalidValueError, match="bands"):
        RhythmSearchConfig(bands=(band, RhythmBand(lowest_hz=0.7, highest_hz=2.0, harmonics=2, step_hz=0.02)))
    with pytest.raises(InvalidValueError, match="highest_hz"):
        RhythmBand(lowest_hz=0.5, highest_hz=0.1, harmonics=2, step_hz=0.02)


@pytest.mark.parametrize("slices", [0, 1, 7, 20])
def test_a_search_under_way_copies_and_pickles_and_finds_the_same(slices):
    window = SampleWindow(span_s=10.0, spacing_s=0.03)
    for k in range(200):
        window.add(k * 40_000_000, 0.005 * np.sin(1.6 * k * 0.04) + 0.0005 * np.sin(7.0 * k * 0.04))
    search = RhythmSearch(RhythmSearchConfig(chunk=20), window)
    for _ in range(slices):
        search.step()
    # The window moves on while the search looks at what it was at its begin.
    window.add(200 * 40_000_000, 0.01)
    copied = pickle.loads(pickle.dumps(copy.deepcopy(search)))  # noqa: S301  our own bytes
    for _ in range(30):
        one, other = search.step(), copied.step()
        assert (one is None) == (other is None)
        if one is not None:
            np.testing.assert_array_equal(one.state, other.state)
            assert one.time_ns == other.time_ns
