import hashlib
import json

import numpy as np
import pytest
from laploop.perception.estimators.compact import SHIPPED_WEIGHTS, CompactEstimator

CARD = SHIPPED_WEIGHTS.with_suffix(".md")
TABLE = SHIPPED_WEIGHTS.with_suffix(".json")


@pytest.fixture(scope="module")
def estimator(rig):
    return CompactEstimator.from_weights(rig)


def test_weights_are_small_enough_to_be_shipped():
    assert SHIPPED_WEIGHTS.stat().st_size < 10e6  # bytes


def test_card_names_the_very_file():
    assert hashlib.sha256(SHIPPED_WEIGHTS.read_bytes()).hexdigest() in CARD.read_text()


def test_card_and_table_agree_and_keep_the_promise():
    rows = {row["model"]: row for row in json.loads(TABLE.read_text())["rows"] if row["working_distance_mm"] == "all"}
    for name, promised_mm in (("compact", 1.2), ("phase", 1.5)):
        assert rows[name]["valid_mae_mm"] <= promised_mm
        assert f"| {rows[name]['valid_mae_mm']:.3f} |" in CARD.read_text()


@pytest.mark.parametrize("depth_m", [0.07, 0.09, 0.11])
def test_plane_is_found_to_half_a_millimetre_by_the_shipped_weights(rig, render, estimator, depth_m):
    depth = np.full((256, 256), depth_m)
    estimate = estimator.estimate(render(rig, depth, rng=np.random.default_rng(0), blur_periods=0.22))
    assert estimate.valid.mean() > 0.7
    error = np.abs(estimate.depth_mm - 1e3 * depth)[estimate.valid]
    assert error.mean() < 0.5  # mm; the picture is simpler than those it has learned from


def test_black_image_has_no_valid_pixel(estimator):
    estimate = estimator.estimate(np.zeros((256, 256), np.uint8))
    assert estimate.valid.mean() < 0.01
    assert np.isfinite(estimate.depth_mm).all()
