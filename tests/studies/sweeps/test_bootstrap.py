import numpy as np
import pytest

from laploop.studies.sweeps.bootstrap import difference, estimate


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
