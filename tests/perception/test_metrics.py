import math

import numpy as np
import pytest

from laploop.errors import InvalidValueError
from laploop.perception.metrics import DepthErrors, bootstrap_interval, depth_metrics


def test_metrics_of_four_pixels_are_as_computed_by_hand():
    truth = np.array([[100.0, 100.0], [50.0, 80.0]], np.float32)
    estimate = np.array([[109.0, 70.0], [50.0, 92.0]], np.float32)
    metrics = depth_metrics(estimate, truth, np.ones((2, 2), bool))
    assert metrics.pixels == 4
    assert metrics.mae_mm == pytest.approx((9 + 30 + 0 + 12) / 4)
    assert metrics.rmse_mm == pytest.approx(math.sqrt((81 + 900 + 0 + 144) / 4))
    assert metrics.bias_mm == pytest.approx((9 - 30 + 0 + 12) / 4)
    assert metrics.abs_rel == pytest.approx((0.09 + 0.30 + 0.0 + 0.15) / 4)
    assert metrics.acc_1_1 == 0.5  # ratios 1.09, 1.43, 1, 1.15
    assert metrics.acc_1_21 == 0.75
    assert metrics.beyond_20mm == 0.25


def test_pixels_outside_the_mask_do_not_count_even_when_nan():
    truth = np.array([[100.0, np.nan]], np.float32)
    metrics = depth_metrics(np.array([[101.0, 7.0]], np.float32), truth, np.array([[True, False]]))
    assert (metrics.pixels, metrics.mae_mm) == (1, 1.0)


def test_adding_frames_is_the_same_as_counting_them_at_once():
    rng = np.random.default_rng(0)
    truth = rng.uniform(60, 140, (4, 8, 8)).astype(np.float32)
    estimate = (truth + rng.normal(0, 5, truth.shape)).astype(np.float32)
    mask = rng.random(truth.shape) < 0.7
    whole, parts = DepthErrors(), DepthErrors()
    whole.add(estimate, truth, mask)
    parts.add(estimate[:2], truth[:2], mask[:2])
    parts.add(estimate[2:], truth[2:], mask[2:])
    assert parts.metrics().mae_mm == pytest.approx(whole.metrics().mae_mm, rel=1e-12)
    assert parts.metrics().acc_1_1 == whole.metrics().acc_1_1


def test_no_pixel_gives_nan_and_not_zero():
    metrics = depth_metrics(np.ones((2, 2), np.float32), np.ones((2, 2), np.float32), np.zeros((2, 2), bool))
    assert metrics.pixels == 0
    assert math.isnan(metrics.mae_mm)


@pytest.mark.parametrize(
    ("estimate", "truth"),
    [
        (np.ones((2, 2)), np.ones((2, 3))),
        (np.ones((2, 2)), np.full((2, 2), np.nan)),
        (np.ones((2, 2)), np.zeros((2, 2))),
        (np.full((2, 2), np.inf), np.ones((2, 2))),
    ],
)
def test_impossible_input_is_refused(estimate, truth):
    with pytest.raises(InvalidValueError):
        depth_metrics(estimate.astype(np.float32), truth.astype(np.float32), np.ones((2, 2), bool))


def test_expected_errors_are_those_of_normal_draws():
    rng = np.random.default_rng(0)
    truth, sigma = np.full((1000, 1000), 100.0, np.float32), np.full((1000, 1000), 9.0)
    drawn, expected = DepthErrors(), DepthErrors()
    everywhere = np.ones(truth.shape, bool)
    drawn.add((truth + rng.normal(0.0, sigma)).astype(np.float32), truth, everywhere)
    expected.add_expected(sigma, truth, everywhere)
    found, wanted = drawn.metrics(), expected.metrics()
    for name in ("mae_mm", "rmse_mm", "abs_rel", "acc_1_1", "acc_1_21", "beyond_20mm"):
        # A million draws: shares and means are good to about 0.1 %, the rare pixels beyond 20 mm to 1 %.
        assert getattr(found, name) == pytest.approx(getattr(wanted, name), rel=0.02), name


def test_expected_errors_of_no_known_size_are_refused():
    with pytest.raises(InvalidValueError, match="sigma"):
        DepthErrors().add_expected(np.full((2, 2), np.nan), np.ones((2, 2), np.float32), np.ones((2, 2), bool))
    with pytest.raises(InvalidValueError, match="shapes"):
        DepthErrors().add_expected(np.ones((2, 3)), np.ones((2, 2), np.float32), np.ones((2, 2), bool))


def group_sums(mean_errors_mm, pixels=100):
    groups = []
    for mean in mean_errors_mm:
        errors = DepthErrors()
        truth = np.full((1, pixels), 100.0, np.float32)
        errors.add(truth + np.float32(mean), truth, np.ones((1, pixels), bool))
        groups.append(errors.sums)
    return np.array(groups)


def test_bootstrap_covers_the_mean_as_often_as_it_says():
    rng = np.random.default_rng(0)
    hits, times = 0, 300
    for _ in range(times):
        interval = bootstrap_interval(group_sums(rng.normal(5.0, 1.0, 30), pixels=4), rng, resamples=300)
        hits += interval.low.mae_mm <= 5.0 <= interval.high.mae_mm
    # 95 % are asked for; the percentile method falls short by about 2 % with 30 groups, chance adds 1.3 % (one sigma).
    assert 0.88 <= hits / times <= 0.99


def test_bootstrap_draws_whole_groups_and_repeats_itself():
    sums = group_sums([1.0, 3.0])
    interval = bootstrap_interval(sums, np.random.default_rng(1))
    assert (interval.low.mae_mm, interval.high.mae_mm) == pytest.approx((1.0, 3.0))  # the same group drawn twice
    assert interval.low.pixels == 200
    assert bootstrap_interval(sums, np.random.default_rng(1)) == interval


def test_one_group_has_no_interval():
    interval = bootstrap_interval(group_sums([2.0]), np.random.default_rng(0))
    assert math.isnan(interval.low.mae_mm)
    assert math.isnan(interval.high.mae_mm)


@pytest.mark.parametrize("change", [{"resamples": 0}, {"confidence": 1.0}, {"confidence": 0.0}])
def test_impossible_bootstrap_is_refused(change):
    with pytest.raises(InvalidValueError):
        bootstrap_interval(group_sums([1.0, 2.0]), np.random.default_rng(0), **change)


def test_further_measures_of_four_pixels_are_as_computed_by_hand():
    truth = np.array([[100.0, 100.0], [50.0, 80.0]], np.float32)
    estimate = np.array([[101.5, 70.0], [50.5, 104.0]], np.float32)
    metrics = depth_metrics(estimate, truth, np.ones((2, 2), bool))
    assert metrics.sq_rel_mm == pytest.approx((2.25 / 100 + 900 / 100 + 0.25 / 50 + 576 / 80) / 4)
    # Ratios 1.015, 1.429, 1.01, 1.3.
    assert (metrics.acc_1_25, metrics.acc_1_331, metrics.acc_1_5625, metrics.acc_1_953) == (0.5, 0.75, 1.0, 1.0)
    assert (metrics.beyond_1mm, metrics.beyond_2mm, metrics.beyond_3mm) == (0.75, 0.5, 0.5)
    assert math.isnan(metrics.slips_per_1000)
    assert math.isnan(metrics.normal_deg)


def test_slips_are_claims_far_off_or_outside_of_the_range():
    truth = np.array([[100.0, 100.0, 59.0, 141.0, 100.0, np.nan]], np.float32)
    estimate = np.array([[109.0, 111.0, 59.0, 140.0, 50.0, 90.0]], np.float32)
    valid = np.array([[True, True, True, True, False, True]])
    errors = DepthErrors()
    errors.add_slips(estimate, truth, valid, (60.0, 140.0))
    assert errors.metrics().slips_per_1000 == pytest.approx(750.0)


def test_expected_shares_are_those_of_normal_draws():
    rng = np.random.default_rng(1)
    truth, sigma = np.full((600, 600), 100.0, np.float32), np.full((600, 600), 12.0)
    drawn, expected = DepthErrors(), DepthErrors()
    everywhere = np.ones(truth.shape, bool)
    drawn.add((truth + rng.normal(0.0, sigma)).astype(np.float32), truth, everywhere)
    expected.add_expected(sigma, truth, everywhere)
    found, wanted = drawn.metrics(), expected.metrics()
    for name in ("sq_rel_mm", "acc_1_331", "acc_1_25", "acc_1_5625", "beyond_1mm", "beyond_2mm", "beyond_3mm"):
        assert getattr(found, name) == pytest.approx(getattr(wanted, name), rel=0.02), name
    assert math.isnan(wanted.normal_deg)


def test_a_measure_that_few_groups_have_is_bootstrapped_over_the_draws_that_hold_it():
    sums = group_sums([1.0, 3.0, 5.0])
    errors = DepthErrors(sums=sums[0].copy())
    truth, everywhere = np.full((1, 10), 100.0, np.float32), np.ones((1, 10), bool)
    errors.add_slips(truth + np.float32(30.0), truth, everywhere, (60.0, 140.0))
    interval = bootstrap_interval(np.array([errors.sums, *sums[1:]]), np.random.default_rng(0))
    assert (interval.low.slips_per_1000, interval.high.slips_per_1000) == (1000.0, 1000.0)
    assert interval.low.mae_mm < interval.high.mae_mm
    assert math.isnan(interval.low.normal_deg)
