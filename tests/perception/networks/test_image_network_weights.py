"""The shipped weights of the networks that know one rig and see the image alone."""

import hashlib
import json
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from laploop.perception.estimators import make_estimator

WEIGHTS = Path(str(files("laploop.assets") / "weights"))
PROMISED_MM = {"ssle": 3.70, "dual-unet": 6.0}
"""Mean absolute error against the reference camera; the paper's network on its bench, and what the baseline must not exceed."""


@pytest.mark.parametrize("name", PROMISED_MM)
def test_card_names_the_very_file(name):
    weights = WEIGHTS / f"{name}.safetensors"
    assert weights.stat().st_size < 10e6  # bytes
    assert hashlib.sha256(weights.read_bytes()).hexdigest() in weights.with_suffix(".md").read_text()


@pytest.mark.parametrize("name", PROMISED_MM)
def test_card_and_table_agree_and_keep_the_promise(name):
    rows = json.loads((WEIGHTS / f"{name}.json").read_text())["rows"]
    wanted = {"model": name, "against": "zivid", "working_distance_mm": "all"}
    row = next(row for row in rows if wanted.items() <= row.items())
    assert row["mae_mm"] < PROMISED_MM[name]
    assert f"| {name} | all | {row['frames']} | {row['mae_mm']:.3f} |" in (WEIGHTS / f"{name}.md").read_text()


@pytest.mark.parametrize("name", PROMISED_MM)
def test_nearer_and_farther_planes_are_told_apart(rig, render, name):
    estimator = make_estimator(name, rig)
    rng, medians = np.random.default_rng(0), []
    for depth_m in (0.075, 0.09, 0.11):
        # As bright as the lamp makes it, from which these networks learn as well.
        image = render(rig, np.full((256, 256), depth_m), rng=rng, blur_periods=0.3, albedo=0.8 * (0.075 / depth_m) ** 2)
        estimate = estimator.estimate(image)
        assert estimate.depth_mm.shape == (256, 256)
        medians.append(float(np.median(estimate.depth_mm[estimate.valid])))
    assert np.all(np.diff(medians) > 3.0)  # mm
    # The picture is simpler than those that they have learned from, so that more than on the test tissues is allowed.
    assert np.abs(np.subtract(medians, [75.0, 90.0, 110.0])).max() < 20.0
