import math

import numpy as np
import pytest

from laploop.control.prediction.alpha_beta import HeldMeasurement
from laploop.control.prediction.rhythm_predictor import RhythmPredictor, RhythmPredictorConfig
from laploop.control.prediction.rhythm_search import RhythmSearch
from laploop.errors import InvalidValueError

FRAME_NS = 40_000_000
LATENCY_S = 0.1


def breathing_and_beating(time_s, *, breath_hz=0.25, beat_hz=1.2, beat=0.0005):
    return 0.005 * np.sin(2.0 * np.pi * breath_hz * time_s + 0.4) + beat * np.sin(2.0 * np.pi * beat_hz * time_s)


def breath_with_a_long_pause(time_s):
    """Peak to peak 10 mm, quiet after breathing out: cos^4, as respiration of ventilated patients is modelled."""
    return 0.01 * np.cos(np.pi * 0.25 * time_s) ** 4


def still(time_s):
    return 0.0 * time_s


def stream(motion, *, seconds=20.0, noise=0.0, seed=0, frame_ns=FRAME_NS, drop=0.0):
    """Make (captured_ns, measured) of a motion; some frames are missing."""
    rng = np.random.default_rng(seed)
    for k in range(round(seconds * 1e9 / frame_ns)):
        measured = float(motion(k * frame_ns * 1e-9)) + noise * rng.standard_normal()
        if rng.random() >= drop:
            yield k * frame_ns, measured


def feed(predictor, motion, measurements, *, after_s=10.0, latency_s=LATENCY_S):
    """Feed a stream; return errors, velocity errors and trust at the moments when measurements arrive, from `after_s` on."""
    errors, velocity_errors, trusted = [], [], []
    for captured_ns, measured in measurements:
        predictor.update(measured, captured_ns)
        now_s = captured_ns * 1e-9 + latency_s
        if now_s >= after_s:
            prediction = predictor.predict(captured_ns + round(latency_s * 1e9))
            rate = (motion(now_s + 1e-4) - motion(now_s - 1e-4)) / 2e-4
            errors.append(prediction.value - motion(now_s))
            velocity_errors.append(prediction.velocity - rate)
            trusted.append(prediction.trusted)
    return np.array(errors), np.array(velocity_errors), np.array(trusted)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize(("breath_hz", "beat_hz"), [(0.12, 0.8), (0.25, 1.2), (0.45, 1.9), (0.58, 2.4)])
def test_unknown_frequencies_are_found_within_ten_seconds(breath_hz, beat_hz):
    def motion(time_s):
        return breathing_and_beating(time_s, breath_hz=breath_hz, beat_hz=beat_hz)

    predictor = RhythmPredictor()
    errors, velocity_errors, trusted = feed(predictor, motion, stream(motion, seconds=16.0), after_s=10.0)
    assert trusted.all()
    assert rms(errors) < 1e-4  # metres; what holding leaves is 0.5 mm and more
    assert rms(velocity_errors) < 1e-3  # m/s; the motion's own is 3 to 14 mm/s
    assert predictor.frequencies_hz == pytest.approx((breath_hz, beat_hz), rel=0.02)


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(("noise", "limit"), [(0.0, 5e-5), (0.00015, 1.5e-4), (0.0003, 2.2e-4)])
def test_prediction_is_at_least_three_times_better_than_none_at_100_ms(noise, limit, seed):
    measurements = list(stream(breathing_and_beating, seconds=20.0, noise=noise, seed=seed, drop=0.03))
    errors, _, trusted = feed(RhythmPredictor(), breathing_and_beating, measurements)
    held, _, _ = feed(HeldMeasurement(), breathing_and_beating, measurements)
    assert trusted.mean() > 0.97
    assert rms(errors) < limit  # metres; measured 0.1, 0.1 and 0.15 mm over many seeds
    assert rms(held) > 3.0 * rms(errors)


def test_drifting_frequencies_are_followed():
    def motion(time_s):
        # 20 % a minute: the phase is the integral of the frequency.
        clock = time_s + 0.1 / 60.0 * time_s**2
        return breathing_and_beating(clock)

    errors, _, trusted = feed(RhythmPredictor(), motion, stream(motion, seconds=30.0, noise=0.0001))
    assert trusted.mean() > 0.97
    assert rms(errors) < 1.5e-4  # metres


def test_respiration_that_is_no_sine_is_predicted_by_its_harmonics():
    errors, _, trusted = feed(RhythmPredictor(), breath_with_a_long_pause, stream(breath_with_a_long_pause, noise=0.0001))
    assert trusted.all()
    assert rms(errors) < 1.2e-4  # metres


def test_frames_at_another_rate_serve_as_well():
    measurements = stream(breathing_and_beating, seconds=20.0, noise=0.0001, frame_ns=32_000_000)
    errors, _, trusted = feed(RhythmPredictor(), breathing_and_beating, measurements)
    assert trusted.all()
    assert rms(errors) < 1.2e-4  # metres


@pytest.mark.parametrize("noise", [0.0, 0.0002])
def test_still_tissue_is_predicted_to_stay(noise):
    errors, velocity_errors, trusted = feed(RhythmPredictor(), still, stream(still, seconds=14.0, noise=noise))
    assert trusted.mean() > 0.9
    assert rms(errors) <= 0.5 * noise
    assert rms(velocity_errors) <= 5.0 * noise  # 1/s: 1 mm/s


def breathing_alone(time_s):
    return breathing_and_beating(time_s, beat=0.0)


def beating_alone(time_s):
    return breathing_and_beating(time_s) - breathing_alone(time_s)


@pytest.mark.parametrize(("motion", "hertz"), [(breathing_alone, 0.25), (beating_alone, 1.2)])
def test_one_rhythm_alone_is_found_and_no_other(motion, hertz):
    predictor = RhythmPredictor()
    errors, _, trusted = feed(predictor, motion, stream(motion, seconds=14.0, noise=0.0001))
    assert trusted.mean() > 0.97
    assert rms(errors) < 1e-4  # metres
    assert predictor.frequencies_hz == pytest.approx((hertz,), rel=0.03)


def test_nothing_is_trusted_before_rhythms_are_known():
    predictor = RhythmPredictor()
    first = predictor.predict(0)
    assert (first.value, first.velocity, first.trusted) == (0.0, 0.0, False)
    assert math.isinf(first.sigma)
    for captured_ns, measured in stream(breathing_and_beating, seconds=2.0):
        predictor.update(measured, captured_ns)
        prediction = predictor.predict(captured_ns + FRAME_NS)
        assert not prediction.trusted
        assert prediction.value == measured
        assert prediction.velocity == 0.0


def trained(motion=breathing_and_beating, *, seconds=15.0, noise=0.0001):
    predictor = RhythmPredictor()
    measurements = list(stream(motion, seconds=seconds, noise=noise))
    for captured_ns, measured in measurements:
        predictor.update(measured, captured_ns)
    return predictor, measurements[-1][0]


def test_trust_ends_when_perception_stops():
    predictor, last_ns = trained()
    assert predictor.predict(last_ns + 300_000_000).trusted
    later = predictor.predict(last_ns + 600_000_000)
    assert not later.trusted
    assert later.velocity == 0.0
    assert later.sigma > predictor.predict(last_ns).sigma


def test_prediction_comes_back_after_perception_stopped_for_two_seconds():
    measurements = [one for one in stream(breathing_and_beating, seconds=30.0, noise=0.0001) if not 15e9 < one[0] < 17e9]
    errors, _, trusted = feed(RhythmPredictor(), breathing_and_beating, measurements, after_s=20.0)
    assert trusted.all()
    assert rms(errors) < 1.2e-4  # metres


@pytest.mark.parametrize("jump", [0.02, -0.02, 0.003])
def test_jump_of_a_single_frame_is_turned_away(jump):
    predictor, last_ns = trained()
    before = predictor.predict(last_ns + 140_000_000)
    assert not predictor.update(float(breathing_and_beating((last_ns + FRAME_NS) * 1e-9)) + jump, last_ns + FRAME_NS)
    after = predictor.predict(last_ns + 140_000_000)
    assert after.trusted
    assert after.value == pytest.approx(before.value, abs=1e-9)  # metres: nothing but rounding


def test_jump_of_a_single_frame_is_turned_away_before_rhythms_are_known():
    predictor, last_ns = trained(seconds=1.0)
    held = predictor.predict(last_ns).value
    assert not predictor.update(held + 0.02, last_ns + FRAME_NS)
    assert predictor.predict(last_ns + FRAME_NS).value == held


@pytest.mark.parametrize("step", [0.02, -0.004, 0.0015])
def test_step_of_the_bias_is_followed_at_once_and_trusted_again_within_three_seconds(step):
    def motion(time_s):
        return breathing_and_beating(time_s) + step * (time_s >= 15.0)

    predictor = RhythmPredictor()
    worst_late, trusted_late = 0.0, []
    for captured_ns, measured in stream(motion, seconds=22.0, noise=0.0001):
        predictor.update(measured, captured_ns)
        now_s = captured_ns * 1e-9 + LATENCY_S
        prediction = predictor.predict(round(now_s * 1e9))
        if now_s > 15.0 + LATENCY_S + 0.2:
            worst_late = max(worst_late, abs(prediction.value - motion(now_s)))
        if now_s > 18.0:
            trusted_late.append(prediction.trusted)
    assert worst_late < 0.0022  # metres; holding alone is wrong by up to 1.2 mm here
    assert np.mean(trusted_late) > 0.98


def test_slow_push_of_the_tissue_never_makes_it_diverge():
    def motion(time_s):
        return breathing_and_beating(time_s) - 0.003 * np.clip((time_s - 15.0) / 2.0, 0.0, 1.0)

    errors, _, trusted = feed(RhythmPredictor(), motion, stream(motion, seconds=30.0, noise=0.0001), after_s=15.0)
    assert np.abs(errors).max() < 0.002  # metres
    assert trusted[-250:].all()
    assert rms(errors[-250:]) < 1.5e-4  # metres


def test_change_of_the_rhythm_is_noticed_and_learnt():
    def motion(time_s):
        # From 15 s on everything goes half as fast again.
        return breathing_and_beating(time_s + 0.5 * np.maximum(time_s - 15.0, 0.0))

    measurements = list(stream(motion, seconds=35.0, noise=0.0001))
    errors, _, trusted = feed(RhythmPredictor(), motion, measurements, after_s=15.0)
    held, _, _ = feed(HeldMeasurement(), motion, measurements, after_s=15.0)
    assert np.abs(errors).max() < 1.5 * np.abs(held).max()
    assert trusted[-200:].mean() > 0.97
    assert rms(errors[-200:]) < 1.5e-4  # metres


def test_measurements_without_agreement_end_in_falling_back():
    predictor, last_ns = trained()
    rng = np.random.default_rng(4)
    for k in range(1, 60):
        predictor.update(float(rng.uniform(-0.05, 0.05)), last_ns + k * FRAME_NS)
    prediction = predictor.predict(last_ns + 60 * FRAME_NS)
    assert not prediction.trusted
    assert math.isfinite(prediction.value)
    assert abs(prediction.value) <= 0.05


@pytest.mark.parametrize("invalid", [None, math.nan, math.inf, -math.inf])
def test_invalid_measurement_changes_nothing(invalid):
    predictor, last_ns = trained()
    before = predictor.predict(last_ns + 100_000_000)
    assert not predictor.update(invalid, last_ns + FRAME_NS)
    assert predictor.predict(last_ns + 100_000_000) == before
    assert predictor.update(float(breathing_and_beating((last_ns + FRAME_NS) * 1e-9)), last_ns + FRAME_NS)


def test_overtaken_measurement_changes_nothing():
    predictor, last_ns = trained()
    before = predictor.predict(last_ns + 100_000_000)
    assert not predictor.update(0.001, last_ns - FRAME_NS)
    assert not predictor.update(0.001, last_ns)
    assert predictor.predict(last_ns + 100_000_000) == before


def test_reported_sigma_is_about_the_error():
    errors, sigmas = [], []
    for seed in range(2):
        predictor = RhythmPredictor()
        for captured_ns, measured in stream(breathing_and_beating, seconds=20.0, noise=0.0003, seed=seed):
            predictor.update(measured, captured_ns)
            if captured_ns > 8_000_000_000:
                prediction = predictor.predict(captured_ns + 100_000_000)
                errors.append(prediction.value - breathing_and_beating(captured_ns * 1e-9 + 0.1))
                sigmas.append(prediction.sigma)
    # The random walks it allows for are more than this stationary motion does: it errs to the cautious side.
    assert 0.8 < rms(sigmas) / rms(errors) < 2.5


def test_same_stream_gives_the_same_bits_also_after_a_reset():
    predictor, last_ns = trained()
    first = predictor.predict(last_ns + 100_000_000)
    predictor.reset()
    assert not predictor.predict(0).trusted
    for captured_ns, measured in stream(breathing_and_beating, seconds=15.0, noise=0.0001):
        predictor.update(measured, captured_ns)
    assert predictor.predict(last_ns + 100_000_000) == first


@pytest.mark.parametrize(
    "fields",
    [{"gate": 1.0}, {"persistence": 1}, {"patience": 2}, {"max_nis": 0.5}, {"min_forecasts": 99}, {"max_sigma_m": math.nan}],
)
def test_impossible_settings_are_refused(fields):
    with pytest.raises(InvalidValueError):
        RhythmPredictorConfig(**fields)


@pytest.fixture
def slices(monkeypatch):
    """Return what every slice of the search found, a list that grows."""
    noted = []
    step = RhythmSearch.step
    monkeypatch.setattr(RhythmSearch, "step", lambda self: noted.append(step(self)) or noted[-1])
    return noted


@pytest.mark.parametrize("times", [1, 3])
def test_work_in_between_changes_no_prediction(slices, times):
    worked, left_alone = RhythmPredictor(), RhythmPredictor()
    for captured_ns, measured in stream(breathing_and_beating, noise=5e-5, seed=4, drop=0.1):
        accepted, saw = [], []
        for predictor in (worked, left_alone):
            accepted.append(predictor.update(measured, captured_ns))
            if predictor is worked:
                before = len(slices)
                for _ in range(times):
                    predictor.work()
                # However often there is time: one slice a measurement.
                assert len(slices) - before <= 1
            prediction = predictor.predict(captured_ns + 140_000_000)
            saw.append((prediction.value, prediction.velocity, prediction.trusted))
        assert accepted[0] == accepted[1]
        assert saw[0] == saw[1]
    assert saw[0][2]
    assert worked.frequencies_hz == left_alone.frequencies_hz


def test_a_measurement_after_work_brings_no_search_with_it(slices):
    predictor = RhythmPredictor()
    for captured_ns, measured in stream(breathing_and_beating, seconds=8.0):
        before = len(slices)
        predictor.update(measured, captured_ns)
        assert len(slices) == before
        predictor.work()
    assert len(slices) > 50
