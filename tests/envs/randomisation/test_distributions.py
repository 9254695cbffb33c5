import math

import numpy as np
import pytest

from laploop.envs.randomisation.distributions import CUT, distribution_of
from laploop.errors import InvalidValueError, UnknownNameError


def drawn(plain, nominal=None, width=1.0, count=2000):
    distribution = distribution_of(plain)
    state = np.random.RandomState(7)
    return [distribution.draw(state, nominal, width) for _ in range(count)]


def test_uniform_has_the_mean_and_the_spread_of_its_range():
    values = drawn({"uniform": [2.0, 6.0]})
    assert min(values) >= 2.0
    assert max(values) <= 6.0
    assert np.mean(values) == pytest.approx(4.0, abs=0.1)
    assert np.std(values) == pytest.approx(4.0 / math.sqrt(12.0), abs=0.05)


def test_loguniform_has_its_median_at_the_geometric_mean():
    assert np.median(drawn({"loguniform": [1.0, 100.0]})) == pytest.approx(10.0, rel=0.1)


@pytest.mark.parametrize("plain", [{"normal": [5.0, 2.0]}, {"lognormal": [5.0, 0.4]}])
def test_tails_are_cut_where_the_ends_are(plain):
    distribution = distribution_of(plain)
    low, high = distribution.samples

    class Far:
        def normal(self, *args, **kwargs):
            return 9.0

    assert distribution.draw(Far(), None, 1.0) == pytest.approx(high)
    values = drawn(plain)
    assert low <= min(values)
    assert np.median(values) == pytest.approx(5.0, rel=0.05)
    assert CUT == 3.0


def test_integers_include_both_ends():
    assert set(drawn({"integers": [3, 6]})) == {3, 4, 5, 6}


def test_choices_keep_their_kinds():
    values = drawn({"choice": ["a", 2, {"kind": "constant"}]}, count=60)
    assert "a" in values
    assert 2 in values
    assert {"kind": "constant"} in values


@pytest.mark.parametrize("kind", ["uniform", "loguniform"])
def test_a_width_moves_both_ends_towards_the_nominal_value(kind):
    values = drawn({kind: [2.0, 6.0]}, nominal=3.0, width=0.5)
    assert min(values) == pytest.approx(2.5, abs=0.02)
    assert max(values) == pytest.approx(4.5, abs=0.02)
    # Without a nominal value the middle counts as one.
    values = drawn({kind: [2.0, 6.0]}, width=0.5)
    assert (min(values), max(values)) == pytest.approx((3.0, 5.0), abs=0.02)


def test_a_width_is_the_share_of_choices_that_are_not_the_nominal_one():
    values = drawn({"choice": ["other"]}, nominal="own", width=0.25)
    assert values.count("other") / len(values) == pytest.approx(0.25, abs=0.03)


@pytest.mark.parametrize(
    ("plain", "words"),
    [
        ({"uniform": [3, 3]}, r"uniform is \[3, 3\]"),
        ({"uniform": [4, 3]}, "the smaller first"),
        ({"uniform": [1, float("nan")]}, "finite"),
        ({"uniform": [1, float("inf")]}, "finite"),
        ({"uniform": [1, 10**400]}, "finite"),
        ({"uniform": [True, 3]}, "finite"),
        ({"uniform": [1, 2, 3]}, "two finite numbers"),
        ({"uniform": "1 to 2"}, "two finite numbers"),
        ({"loguniform": [0, 1]}, "above 0"),
        ({"normal": [1, 0]}, "standard deviation above 0"),
        ({"lognormal": [-1, 1]}, "median above 0"),
        ({"integers": [1.5, 3]}, "two integers"),
        ({"choice": []}, "at least one value"),
        ({"choice": [{"a": [float("nan")]}]}, "finite"),
        ({"uniform": [1, 2], "normal": [1, 2]}, "a table such as"),
        ([1, 2], "a table such as"),
    ],
)
def test_what_is_no_distribution_is_refused(plain, words):
    with pytest.raises(InvalidValueError, match=words):
        distribution_of(plain)


def test_an_unknown_distribution_is_refused_with_the_nearest():
    with pytest.raises(UnknownNameError, match="did you mean 'uniform'"):
        distribution_of({"unifrom": [1, 2]})
