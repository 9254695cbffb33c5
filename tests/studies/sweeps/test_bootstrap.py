import numpy as np
import pytest

from laploop.studies.sweeps.bootstrap import difference, estimate, nested_estimate


def test_the_interval_has_the_width_of_the_standard_error():
    values = np.random.default_rng(1).normal(5.0, 2.0, 400).tolist()
    found = estimate([*values, None])
    assert found.mean == pytest.approx(np.mean(values))
    assert found.high - found.low == pytest.approx(2 * 1.96 * np.std(values) / 20.0, rel=0.1)
    assert found.count == 400


def test_pairs_cancel_what_they_share():
    shared = np.random.default_rng(2).normal(0.0, 10.0, 50)
    ours, others = (shared + 0.5).tolist(), shared.tolist()
    paired = difference(ours, others, paired=True)
    assert (paired.low, paired.high) == (pytest.approx(0.5), pytest.approx(0.5))
    apart = difference(ours, others, paired=False)
    assert apart.mean == pytest.approx(0.5)
    assert apart.high - apart.low > 5.0


def test_an_unmeasured_episode_leaves_its_pair_out():
    assert difference([1.0, None, 3.0], [0.0, 5.0, None], paired=True).mean == 1.0
    assert difference([None], [1.0], paired=True) is None
    assert estimate([None]) is None
    assert estimate([1.0, 2.0]) == estimate([1.0, 2.0])


def test_groups_that_differ_widen_the_interval():
    rng = np.random.default_rng(3)
    alike = [rng.normal(1.0, 0.1, 50) for _ in range(3)]
    apart = [values + offset for values, offset in zip(alike, (-1.0, 0.0, 1.0), strict=True)]
    narrow, wide = nested_estimate(alike), nested_estimate(apart)
    assert wide.mean == pytest.approx(narrow.mean)
    assert wide.high - wide.low > 5.0 * (narrow.high - narrow.low)
    assert nested_estimate([[], []]) is None
    assert nested_estimate([[2.0], []]).mean == 2.0
