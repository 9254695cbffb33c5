"""Every seed makes a different, plausible, well-formed tissue."""

import numpy as np
import pytest

from laploop.assets.tissue_config import TissueShape
from laploop.assets.tissue_shape import height_field

SHAPE = TissueShape()
SEEDS = range(12)


def tissue(seed, shape=SHAPE):
    return height_field(shape, np.random.default_rng(seed))


def test_same_seed_gives_the_same_bits():
    np.testing.assert_array_equal(tissue(3), tissue(3))


def test_two_seeds_differ():
    # Millimetres: far more than any rounding.
    assert np.abs(tissue(3) - tissue(4)).mean() > 1e-3


@pytest.mark.parametrize("seed", SEEDS)
def test_heights_and_slopes_are_those_of_folded_bowel(seed):
    height = tissue(seed)
    assert height.max() <= SHAPE.height_m + 1e-12
    assert height.min() > 0.003
    inside = height[7:-7, 7:-7]
    # Folds: at least a lobe's height between crest and crease.
    assert np.ptp(inside) > SHAPE.lobe_height_m
    slope = np.degrees(np.arctan(np.hypot(*np.gradient(inside, SHAPE.spacing_m))))
    assert np.mean(slope < 40.0) > 0.4
    assert np.mean(slope > 60.0) < 0.02
