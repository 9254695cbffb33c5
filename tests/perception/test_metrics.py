import math

import numpy as np
import pytest

from laploop.errors import InvalidValueError
from laploop.perception.metrics import DepthErrors, depth_metrics


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
    whole, first, second = DepthErrors(), DepthErrors(), DepthErrors()
    whole.add(estimate, truth, mask)
    first.add(estimate[:2], truth[:2], mask[:2])
    second.add(estimate[2:], truth[2:], mask[2:])
    first.merge(second)
    assert first.metrics().mae_mm == pytest.approx(whole.metrics().mae_mm, rel=1e-12)
    assert first.metrics().acc_1_1 == whole.metrics().acc_1_1


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
