import math

import numpy as np
import pytest

from laploop.errors import InvalidValueError
from laploop.perception.bootstrap import UNKNOWN
from laploop.perception.slip_calibration import SLIP_EDGES, SlipCalibration, SlipCounts

SHAPE = (400, 500)
TRUTH = np.full(SHAPE, 100.0, np.float32)


def counted(slip, estimate_mm, truth_mm=TRUTH, valid=None):
    counts = SlipCounts()
    counts.add(slip.astype(np.float32), estimate_mm.astype(np.float32), slip <= 0.05 if valid is None else valid, truth_mm)
    return counts


def calibration(*groups):
    return SlipCalibration.of_groups(np.array([group.sums for group in groups]), np.random.default_rng(0))


def test_honest_probabilities_are_seen_again_in_every_bin():
    rng = np.random.default_rng(0)
    slip = 10.0 ** rng.uniform(-3.5, 0.0, SHAPE)
    found = calibration(counted(slip, np.where(rng.random(SHAPE) < slip, 111.0, 109.0)))
    for part, low, high in zip(found.bins, SLIP_EDGES, SLIP_EDGES[1:], strict=False):
        assert low < part.predicted <= high
        # Three standard deviations of what chance makes of so many pixels.
        assert abs(part.seen - part.predicted) < 3.0 * math.sqrt(part.predicted / part.pixels)
    assert sum(part.pixels for part in found.bins) == found.every.pixels == slip.size
    assert found.every.predicted == pytest.approx(slip.mean(), rel=1e-6)
    assert found.valid.pixels == (slip <= 0.05).sum()


def test_a_slip_is_more_than_a_tenth_off_or_outside_of_the_working_range():
    slip = np.full(SHAPE, 0.3)
    truth, estimate = TRUTH.copy(), TRUTH.copy()
    truth[:100], truth[100:200], truth[200:300] = 59.0, 141.0, np.nan
    estimate[:100], estimate[100:200], estimate[300:350], estimate[350:] = 59.0, 141.0, 89.0, 90.5
    found = calibration(counted(slip, estimate, truth))
    assert found.every.pixels == 300 * 500  # without a truth there is nothing to see
    assert found.every.seen == pytest.approx(250 / 300)
    assert (found.valid.pixels, found.valid_seen) == (0, UNKNOWN)
    assert math.isnan(found.valid.predicted)


def test_seen_rates_have_the_interval_of_whole_groups():
    slip = np.full(SHAPE, 0.01)
    good, bad = counted(slip, TRUTH), counted(slip, TRUTH + 20.0)
    found = calibration(good, SlipCounts(), bad)
    assert (found.valid_seen.value, found.valid_seen.low, found.valid_seen.high) == pytest.approx((0.5, 0.0, 1.0))
    assert found.every_seen == found.valid_seen
    assert calibration(SlipCounts()).every_seen == UNKNOWN


def test_frames_add_up():
    rng = np.random.default_rng(1)
    slip, estimate = rng.random(SHAPE), rng.uniform(80.0, 120.0, SHAPE)
    parts = SlipCounts()
    for half in (slice(0, 200), slice(200, 400)):
        values = slip[half].astype(np.float32)
        parts.add(values, estimate[half].astype(np.float32), slip[half] <= 0.05, TRUTH[half])
    np.testing.assert_allclose(parts.sums, counted(slip, estimate).sums)
    with pytest.raises(InvalidValueError, match="four equal shapes"):
        parts.add(TRUTH[:1], TRUTH, TRUTH > 0.0, TRUTH)
