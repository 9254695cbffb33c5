import math

import numpy as np
import pytest

from laploop.errors import InvalidValueError
from laploop.perception import bootstrap
from laploop.perception.bootstrap import UNKNOWN, bootstrap_ends, bounded, bounded_ratio


def rng():
    return np.random.default_rng(3)


def ratio_and_total(sums):
    return np.stack([sums[:, 0] / sums[:, 1], sums[:, 1]], axis=1)


def test_a_ratio_is_that_of_the_sums_and_its_interval_that_of_whole_groups():
    ratio = bounded_ratio(np.array([[1.0, 10.0], [6.0, 10.0]]), rng())
    assert (ratio.value, ratio.low, ratio.high) == pytest.approx((0.35, 0.1, 0.6))
    assert bounded_ratio(np.array([[1.0, 10.0], [6.0, 10.0]]), rng()) == ratio


def test_groups_without_anything_to_divide_by_are_not_drawn():
    ratio = bounded_ratio(np.array([[1.0, 10.0], [0.0, 0.0], [6.0, 10.0]]), rng())
    assert ratio == bounded_ratio(np.array([[1.0, 10.0], [6.0, 10.0]]), rng())
    one = bounded_ratio(np.array([[1.0, 10.0], [0.0, 0.0]]), rng())
    assert one.value == 0.1
    assert math.isnan(one.low)
    assert math.isnan(one.high)
    assert bounded_ratio(np.zeros((3, 2)), rng()) == UNKNOWN


def test_draws_in_parts_give_the_interval_of_all_at_once(monkeypatch):
    sums = np.random.default_rng(0).uniform(1.0, 2.0, (12, 2))
    whole = bounded(sums, ratio_and_total, rng())
    for numbers in (2, 100):
        monkeypatch.setattr(bootstrap, "_NUMBERS", numbers)
        for part, all_at_once in zip(bounded(sums, ratio_and_total, rng()), whole, strict=True):
            assert (part.value, part.low, part.high) == pytest.approx((all_at_once.value, all_at_once.low, all_at_once.high))


@pytest.mark.parametrize("change", [{"resamples": 0}, {"resamples": 10, "confidence": 1.0}])
def test_impossible_draws_are_refused(change):
    with pytest.raises(InvalidValueError):
        bootstrap_ends(np.ones((3, 2)), ratio_and_total, rng(), **change)
