import numpy as np
import pytest

from laploop.control.prediction.sample_window import SampleWindow
from laploop.errors import InvalidValueError


def test_old_samples_leave_and_order_stays_over_many_spans():
    window = SampleWindow(span_s=1.0, spacing_s=0.03)
    for k in range(500):
        window.add(k * 40_000_000, float(k))
    time_ns, seconds, values = window.snapshot()
    assert time_ns == 499 * 40_000_000
    assert np.array_equal(values, np.arange(474.0, 500.0))
    np.testing.assert_allclose(seconds, (np.arange(474, 500) - 499) * 0.04, atol=1e-12)
    assert window.covered_s == pytest.approx(1.0)


def test_samples_that_are_too_close_are_left_out():
    window = SampleWindow(span_s=1.0, spacing_s=0.03)
    for k in range(1000):
        window.add(k * 2_000_000, float(k))
    seconds = window.snapshot()[1]
    assert np.diff(seconds).min() == pytest.approx(0.03)


def test_shift_moves_what_is_there_and_clear_empties():
    window = SampleWindow(span_s=1.0, spacing_s=0.03)
    window.add(0, 1.0)
    window.add(40_000_000, 2.0)
    window.shift(0.5)
    window.add(80_000_000, 3.0)
    assert np.array_equal(window.snapshot()[2], [1.5, 2.5, 3.0])
    window.clear()
    assert window.covered_s == 0.0


def test_spacing_must_fit_the_span():
    with pytest.raises(InvalidValueError, match="span_s"):
        SampleWindow(span_s=0.05, spacing_s=0.03)
