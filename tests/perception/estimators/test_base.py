"""What an estimator returns is checked where the loop and the studies receive it."""

import numpy as np
import pytest

from laploop.errors import InvalidValueError
from laploop.perception.estimators.base import checked_estimate
from laploop.perception.messages import DepthEstimate

SHAPE = (4, 6)


def estimate(depth_mm, valid=True):
    full = np.full(SHAPE, 90.0, np.float32)
    full[1, 2] = depth_mm
    return DepthEstimate(depth_mm=full, valid=np.full(SHAPE, valid))


def test_a_good_estimate_passes_as_it_is():
    good = estimate(80.0)
    assert checked_estimate(good, SHAPE) is good


@pytest.mark.parametrize(
    ("returned", "shown"),
    [
        (None, "nothing"),
        (np.zeros(SHAPE), r"an array of float64, shape \(4, 6\)"),
        ((np.zeros(SHAPE), np.ones(SHAPE, bool)), "tuple"),
        (3.5, "float"),
        (DepthEstimate, "type"),
    ],
)
def test_another_type_is_refused_with_what_was_returned_and_what_is_expected(returned, shown):
    with pytest.raises(InvalidValueError, match=rf"estimate is '{shown}'.*a DepthEstimate.*\(4, 6\)") as caught:
        checked_estimate(returned, SHAPE)
    assert "\n" not in str(caught.value)


def test_another_shape_is_refused():
    with pytest.raises(InvalidValueError, match=r"shape of the estimate is \(4, 6\); allowed: \(6, 4\)"):
        checked_estimate(estimate(80.0), (6, 4))


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf, 0.0, -50.0])
def test_a_valid_depth_is_finite_and_positive(wrong):
    with pytest.raises(InvalidValueError, match=r"finite and above 0 where valid is True; 1 of 24 pixels"):
        checked_estimate(estimate(wrong), SHAPE)


def test_depth_that_is_not_finite_becomes_0_where_it_is_invalid():
    checked = checked_estimate(estimate(np.nan, valid=False), SHAPE)
    assert checked.depth_mm[1, 2] == 0.0
    assert (np.delete(checked.depth_mm.ravel(), 8) == 90.0).all()
    assert not checked.valid.any()


@pytest.mark.parametrize(
    ("depth_mm", "valid", "message"),
    [
        ([[1.0]], np.ones((1, 1), bool), "type of depth_mm"),
        (np.ones((2, 2), np.float32), None, "type of valid"),
        (np.ones((2, 2)), np.ones((2, 2), bool), "float64"),
        (np.ones((2, 2), np.float32), np.ones((2, 2)), "float64"),
        (np.ones((2, 2), np.float32), np.ones((2, 3), bool), "shape of depth_mm and valid"),
    ],
)
def test_an_estimate_of_other_arrays_cannot_be_made(depth_mm, valid, message):
    with pytest.raises(InvalidValueError, match=message):
        DepthEstimate(depth_mm=depth_mm, valid=valid)
