from dataclasses import replace

import numpy as np
import pytest

from laploop.errors import InvalidValueError, UnknownNameError
from laploop.studies.acquisition.config import AcquisitionConfig, StageRanges

SMALL = AcquisitionConfig(pairs=7, tissues=3, workers=1)


def test_pairs_are_spread_evenly_and_splits_follow_the_paper():
    plan = AcquisitionConfig()
    assert np.bincount(plan.tissue_of_pair).tolist() == [19] * 38
    assert plan.split_counts == (26, 4, 8)
    assert np.bincount(replace(plan, pairs=100).tissue_of_pair).tolist() == [3] * 24 + [2] * 14
    assert replace(plan, tissues=3, pairs=9).split_counts == (1, 1, 1)
    assert replace(plan, pairs=2).split_counts == (1, 0, 1)
    assert replace(plan, pairs=1).split_counts == (1, 0, 0)
    for tissues in range(3, 100):
        counts = replace(plan, tissues=tissues).split_counts
        assert sum(counts) == tissues
        assert min(counts) >= 1


@pytest.mark.parametrize(
    "change",
    [
        {"pairs": 0},
        {"tissues": 0},
        {"workers": 0},
        {"tool_share": 1.5},
        {"seed": -1},
        {"calibration_views": 4},
        {"exposure_level": (0.5, 0.4)},
        {"split_tissues": (1, 1, 2)},
        {"split_tissues": (3, -1, 1)},
    ],
)
def test_impossible_plan_is_refused(change):
    with pytest.raises(InvalidValueError, match=next(iter(change))):
        replace(SMALL, **change)


def test_split_that_does_not_add_up_says_what_it_should_add_up_to():
    with pytest.raises(InvalidValueError, match="add up to the 3 tissues"):
        replace(SMALL, split_tissues=(2, 1, 1))
    assert replace(SMALL, split_tissues=(2, 0, 1)).split_of_pair.tolist() == [0, 0, 0, 0, 0, 2, 2]


def test_unknown_engine_and_impossible_stage_are_refused():
    with pytest.raises(UnknownNameError, match="process, ray"):
        replace(SMALL, engine="slurm")
    with pytest.raises(InvalidValueError, match="working_distance_m"):
        StageRanges(working_distance_m=(0.02, 0.1))
