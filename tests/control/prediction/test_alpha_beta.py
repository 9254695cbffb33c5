import numpy as np
import pytest

from laploop.control.prediction.alpha_beta import AlphaBetaFilter, AlphaBetaFilterConfig, HeldMeasurement
from laploop.errors import InvalidValueError

FRAME_NS = 40_000_000
LATENCY_NS = 60_000_000


def started(config=None, *, start_ns=0):
    """Return a filter whose first measurement was a displacement of zero."""
    tracker = AlphaBetaFilter(config)
    assert tracker.update(0.0, start_ns)
    return tracker


def breathing(time_s):
    return 0.005 * np.sin(2.0 * np.pi * 0.25 * time_s)


def rms_error_under_breathing(config):
    tracker = started(config)
    errors = []
    for k in range(1, 500):
        tracker.update(breathing(k * 0.04), k * FRAME_NS)
        now_ns = k * FRAME_NS + LATENCY_NS
        errors.append(tracker.displacement_at(now_ns) - breathing(now_ns * 1e-9))
    return float(np.sqrt(np.mean(np.square(errors[50:]))))


def test_constant_rate_is_followed_without_lag():
    tracker = started()
    for k in range(1, 60):
        tracker.update(0.01 * k * 0.04, k * FRAME_NS)
    assert tracker.rate_at(59 * FRAME_NS) == pytest.approx(0.01, abs=1e-6)
    now_ns = 59 * FRAME_NS + LATENCY_NS
    assert tracker.displacement_at(now_ns) == pytest.approx(0.01 * now_ns * 1e-9, abs=1e-6)  # metres


def test_extrapolation_is_worth_its_while_under_breathing():
    extrapolated = rms_error_under_breathing(AlphaBetaFilterConfig())
    held = rms_error_under_breathing(AlphaBetaFilterConfig(alpha=1.0, beta=0.0))
    assert extrapolated < 0.3 * held
    assert extrapolated < 1.2e-4  # metres, at 60 ms of latency


def test_extrapolation_ends():
    tracker = started()
    for k in range(1, 60):
        tracker.update(0.01 * k * 0.04, k * FRAME_NS)
    late, later = (tracker.displacement_at(59 * FRAME_NS + seconds * 1_000_000_000) for seconds in (1, 10))
    assert late == later
    assert tracker.rate_at(60 * 1_000_000_000) == 0.0


def test_single_jump_is_rejected():
    tracker = started()
    assert tracker.update(0.0, FRAME_NS)
    assert not tracker.update(0.02, 2 * FRAME_NS)
    assert tracker.measured_ns == FRAME_NS
    assert tracker.displacement_at(2 * FRAME_NS) == 0.0


def test_jump_that_persists_is_accepted_at_the_third_time():
    tracker = started()
    accepted = [tracker.update(0.02, k * FRAME_NS) for k in (1, 2, 3)]
    assert accepted == [False, False, True]
    assert tracker.displacement_at(3 * FRAME_NS) == 0.02
    assert tracker.rate_at(3 * FRAME_NS) == 0.0


def test_jumps_that_contradict_each_other_are_never_accepted():
    tracker = started()
    assert not any(tracker.update(sign * 0.02, (k + 1) * FRAME_NS) for k, sign in enumerate([1, -1] * 10))


def test_rate_is_bounded():
    tracker = started(AlphaBetaFilterConfig(max_rate_mps=0.02))
    rates = []
    for k in range(1, 30):
        tracker.update(0.005 * k, k * FRAME_NS)  # 125 mm/s
        rates.append(tracker.rate_at(k * FRAME_NS))
    assert max(rates) == 0.02


def test_as_a_predictor_it_goes_on_at_the_rate_and_is_never_trusted():
    tracker = started()
    for k in range(1, 60):
        tracker.update(0.01 * k * 0.04, k * FRAME_NS)
    now_ns = 59 * FRAME_NS + LATENCY_NS
    prediction = tracker.predict(now_ns)
    assert (prediction.value, prediction.velocity) == (tracker.displacement_at(now_ns), tracker.rate_at(now_ns))
    assert not prediction.trusted


def test_held_measurement_is_the_newest():
    held = HeldMeasurement()
    assert held.predict(0).value == 0.0
    assert held.update(0.002, 10)
    assert not held.update(0.003, 10)
    assert not held.update(None, 20)
    assert not held.update(np.nan, 20)
    assert held.update(0.004, 30)
    prediction = held.predict(1_000)
    assert (prediction.value, prediction.velocity) == (0.004, 0.0)
    held.reset()
    assert held.predict(0).value == 0.0


def test_measurement_from_the_past_is_ignored():
    tracker = started(start_ns=5 * FRAME_NS)
    assert not tracker.update(0.001, 4 * FRAME_NS)
    assert tracker.displacement_at(5 * FRAME_NS) == 0.0


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("alpha", 1.1),
        ("beta", -0.1),
        ("max_jump_m", 0.0),
        ("persistence", 0),
        ("max_rate_mps", 0.0),
        ("max_extrapolation_s", -1.0),
    ],
)
def test_bad_configuration_names_the_field(field, value):
    with pytest.raises(InvalidValueError, match=field):
        AlphaBetaFilterConfig(**{field: value})
