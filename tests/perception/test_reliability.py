import math

import numpy as np
import pytest

from laploop.errors import InvalidValueError
from laploop.perception.bootstrap import UNKNOWN
from laploop.perception.reliability import ReliabilityErrors, bounded_scores

SHAPE = (400, 500)
EVERYWHERE = np.ones(SHAPE, bool)
TRUTH = np.full(SHAPE, 100.0, np.float32)


def measured(confidence, error_mm, mask=EVERYWHERE):
    errors = ReliabilityErrors()
    errors.add(confidence.astype(np.float32), (TRUTH + error_mm).astype(np.float32), TRUTH, mask)
    return errors


def test_a_confidence_that_sorts_by_error_has_the_area_of_the_sorted_errors():
    error = np.random.default_rng(0).uniform(0.0, 4.0, SHAPE)
    sorting, random = measured(1.0 - error / 4.0, error), measured(np.random.default_rng(1).random(SHAPE), error)
    # Sorted errors rise linearly to 4 mm: the risk at coverage c is 2 c, its mean 1.
    assert sorting.aurc_mm == pytest.approx(1.0, abs=0.01)
    assert random.aurc_mm == pytest.approx(2.0, abs=0.02)
    np.testing.assert_allclose(sorting.risk_mm(np.array([0.1, 0.5, 1.0])), [0.2, 1.0, 2.0], atol=0.02)
    assert measured(error / 4.0, error).aurc_mm == pytest.approx(3.0, abs=0.01)


def test_a_constant_confidence_admits_all_pixels_at_once():
    errors = measured(np.full(SHAPE, 0.5), np.full(SHAPE, 1.5))
    assert errors.aurc_mm == pytest.approx(1.5)
    assert errors.risk_mm(np.array([0.1]))[0] == pytest.approx(1.5)


def test_calibration_compares_what_is_predicted_with_what_is_seen():
    rng = np.random.default_rng(2)
    confidence = rng.random(SHAPE)
    near = rng.random(SHAPE) < confidence
    honest = measured(confidence, np.where(near, 0.5, 2.0))
    assert honest.calibration_error < 0.01
    for number, part in enumerate(honest.tenths()):
        assert part.predicted == pytest.approx(0.1 * number + 0.05, abs=0.002)
        assert part.seen == pytest.approx(part.predicted, abs=0.02)
    assert sum(part.pixels for part in honest.tenths()) == near.size
    boastful = measured(np.full(SHAPE, 1.0), np.where(near, 0.5, 2.0))
    assert boastful.calibration_error == pytest.approx(0.5, abs=0.01)
    assert [part.pixels for part in boastful.tenths()] == [0] * 9 + [near.size]


def test_frames_add_up_and_pixels_outside_the_mask_do_not_count():
    confidence = np.random.default_rng(3).random(SHAPE)
    error = np.random.default_rng(4).normal(0.0, 2.0, SHAPE)
    parts = ReliabilityErrors()
    half = EVERYWHERE.copy()
    half[200:] = False
    for mask in (half, ~half):
        parts.add(confidence.astype(np.float32), (TRUTH + error).astype(np.float32), TRUTH, mask)
    whole = measured(confidence, error)
    np.testing.assert_allclose(parts.sums, whole.sums)
    assert measured(confidence, error, half).sums[:, 0].sum() == half.sum()


def test_nothing_counted_is_nothing_known():
    errors = ReliabilityErrors()
    assert math.isnan(errors.aurc_mm)
    assert math.isnan(errors.calibration_error)
    assert np.isnan(errors.risk_mm(np.array([0.5]))).all()
    with pytest.raises(InvalidValueError, match="four equal shapes"):
        errors.add(TRUTH[:1], TRUTH, TRUTH, EVERYWHERE)


def test_scores_have_the_interval_of_whole_scenes():
    good = measured(np.full(SHAPE, 0.95), np.full(SHAPE, 0.5))
    bad = measured(np.full(SHAPE, 0.45), np.full(SHAPE, 4.0))
    scenes = np.array([good.sums, ReliabilityErrors().sums, bad.sums])
    aurc_mm, calibration_error = bounded_scores(scenes, np.random.default_rng(0))
    whole = ReliabilityErrors(sums=scenes.sum(axis=0))
    assert (aurc_mm.value, aurc_mm.low, aurc_mm.high) == pytest.approx((whole.aurc_mm, 0.5, 4.0))
    found = (calibration_error.value, calibration_error.low, calibration_error.high)
    assert found == pytest.approx((whole.calibration_error, 0.05, 0.45), abs=1e-6)  # a confidence is a float32
    assert bounded_scores(scenes[1:2], np.random.default_rng(0)) == (UNKNOWN, UNKNOWN)
