import numpy as np
import pytest

from laploop.assets.tissue_appearance import (
    AppearanceRanges,
    TissueAppearance,
    appearance_factor,
    draw_appearance,
    tissue_albedo,
)
from laploop.errors import InvalidValueError

POINTS = np.stack(np.meshgrid(np.linspace(-0.1, 0.1, 101), np.linspace(-0.1, 0.1, 101), [0.0]), axis=-1).reshape(-1, 3)


@pytest.mark.parametrize("coverage", [0.05, 0.2, 0.5])
def test_patches_have_the_given_coverage_and_darkness(coverage):
    appearance = TissueAppearance(coverage=coverage, darkness=0.7)
    factor = appearance_factor(POINTS, appearance, np.random.default_rng(1))
    # Half-way up its soft border a patch has taken half of its darkness.
    assert (factor < 1.0 - 0.5 * 0.7).mean() == pytest.approx(coverage, abs=0.003)
    assert factor.min() == pytest.approx(0.3, abs=1e-5)
    assert factor.max() == 1.0


def test_patches_grow_with_their_size():
    areas = []
    for size in (0.008, 0.016):
        factor = appearance_factor(POINTS, TissueAppearance(coverage=0.15, patch_size_m=size), np.random.default_rng(2))
        dark = factor.reshape(101, 101) < 0.7
        borders = (dark[1:] != dark[:-1]).sum() + (dark[:, 1:] != dark[:, :-1]).sum()
        areas.append(dark.sum() / borders)
    # Area over outline grows as the size does.
    assert areas[1] / areas[0] == pytest.approx(2.0, rel=0.35)


def test_darker_patches_stay_where_they_are():
    factors = [
        appearance_factor(POINTS, TissueAppearance(coverage=0.1, darkness=d), np.random.default_rng(3)) for d in (0.3, 0.6)
    ]
    np.testing.assert_allclose((1.0 - factors[1]) / 0.6, (1.0 - factors[0]) / 0.3, atol=1e-5)


def test_detail_varies_the_albedo_by_its_standard_deviation():
    factor = appearance_factor(POINTS, TissueAppearance(detail=0.1), np.random.default_rng(5))
    assert factor.std() == pytest.approx(0.1, rel=0.15)
    assert factor.mean() == pytest.approx(1.0, abs=0.01)


def test_appearances_are_drawn_from_their_ranges():
    ranges = AppearanceRanges()
    draws = [draw_appearance(np.random.default_rng(seed), ranges) for seed in range(60)]
    assert draws[2] == draw_appearance(np.random.default_rng(2), ranges)
    for name in ("coverage", "darkness", "patch_size_m", "detail"):
        low, high = getattr(ranges, name)
        values = [getattr(draw, name) for draw in draws]
        assert low <= min(values) < max(values) <= high
        assert max(values) - min(values) > 0.8 * (high - low)
    with pytest.raises(InvalidValueError, match="darkness"):
        AppearanceRanges(darkness=(0.8, 0.3))


@pytest.mark.parametrize(("field", "value"), [("coverage", 1.0), ("darkness", -0.1), ("patch_size_m", 0.0), ("detail", 1.0)])
def test_impossible_appearances_are_refused_by_name(field, value):
    with pytest.raises(InvalidValueError, match=field):
        TissueAppearance(**{field: value})


def test_texture_is_seeded_smooth_and_around_one():
    side = np.linspace(-0.06, 0.06, 61)
    points = np.stack(np.meshgrid(side, side, [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
    first, again, other = (tissue_albedo(points, TissueAppearance(), np.random.default_rng(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).mean() > 0.02
    assert first.mean() == pytest.approx(1.0, abs=0.1)
    assert 0.04 < first.std() < 0.25
    # Waves of at least 8 mm cannot turn over within the 2 mm between vertices.
    assert np.abs(np.diff(first.reshape(61, 61), axis=0)).max() < 0.3
