import math

import numpy as np
import pytest

from laploop.control.prediction.recent_mean import RecentMean


def test_mean_is_that_of_the_last_numbers():
    rng = np.random.default_rng(0)
    numbers = rng.normal(size=500).tolist()
    recent = RecentMean(20)
    for count, number in enumerate(numbers, start=1):
        recent.append(number)
        assert len(recent) == min(count, 20)
        assert recent.mean == pytest.approx(np.mean(numbers[max(0, count - 20) : count]), abs=1e-15)
    assert recent.mean_of_last(7) == pytest.approx(np.mean(numbers[-7:]))
    assert recent.mean_of_last(100) == pytest.approx(recent.mean)


def test_a_huge_number_leaves_no_trace_once_it_has_gone():
    recent = RecentMean(4)
    for number in (1e18, 1.0, 2.0, 3.0, 4.0, 1.0, 2.0, 3.0, 4.0):
        recent.append(number)
    assert recent.mean == 2.5


def test_mean_of_nothing_is_infinite():
    recent = RecentMean(4)
    recent.append(1.0)
    recent.clear()
    assert recent.mean == math.inf
    assert recent.mean_of_last(3) == math.inf
    assert len(recent) == 0
