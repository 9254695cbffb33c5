import math

import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.envs.sensors.optics.scope_ranges import ScopeRanges, draw_scope
from laploop.errors import InvalidValueError

NOMINAL = ScopeOptics()


def test_scopes_fill_their_ranges_and_the_same_seed_draws_the_same_one():
    ranges = ScopeRanges()
    scopes = [draw_scope(NOMINAL, np.random.default_rng(seed), ranges) for seed in range(300)]
    assert scopes[3] == draw_scope(NOMINAL, np.random.default_rng(3), ranges)
    for values, (low, high) in (
        ([s.baseline_m for s in scopes], ranges.baseline_m),
        ([s.fov_rad for s in scopes], ranges.fov_rad),
        ([s.mask.duty for s in scopes], ranges.duty),
        ([s.mask.phase for s in scopes], ranges.phase),
    ):
        assert low <= min(values) < max(values) <= high
        # The chance that 300 even draws leave a twentieth free at either end is below 1e-6.
        assert max(values) - min(values) > 0.9 * (high - low)
    assert {s.mask.stripes for s in scopes} == set(range(14, 29))
    assert all(s.mask.fov_rad == s.fov_rad for s in scopes)
    assert all((s.width, s.height, s.mask.edge_roughness) == (256, 256, 0.0) for s in scopes)


def test_a_fixed_range_leaves_the_other_draws_alone():
    free = draw_scope(NOMINAL, np.random.default_rng(5), ScopeRanges())
    fixed = ScopeRanges(baseline_m=(0.005, 0.005), stripes=(20, 20), mask_fov_rad=(1.2, 1.2))
    scope = draw_scope(NOMINAL, np.random.default_rng(5), fixed)
    assert (scope.baseline_m, scope.mask.stripes, scope.mask.fov_rad) == (0.005, 20, 1.2)
    assert (scope.fov_rad, scope.mask.duty, scope.mask.phase) == (free.fov_rad, free.mask.duty, free.mask.phase)


def test_a_drawn_pattern_keeps_its_stripes():
    pattern = StripeMask(profile=(0.0, 1.0, 0.0), stripes=7)
    mask = draw_scope(ScopeOptics(mask=pattern), np.random.default_rng(1), ScopeRanges()).mask
    assert (mask.profile, mask.stripes) == (pattern.profile, 7)
    assert mask.fov_rad != pattern.fov_rad


@pytest.mark.parametrize(
    ("field", "span"),
    [("baseline_m", (0.006, 0.004)), ("stripes", (0, 20)), ("duty", (0.4, 1.0)), ("fov_rad", (1.0, math.inf))],
)
def test_empty_or_impossible_ranges_are_refused_by_name(field, span):
    with pytest.raises(InvalidValueError, match=field):
        ScopeRanges(**{field: span})
