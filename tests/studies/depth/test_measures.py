"""Sets of pixels, families and confidence, from a data set to the files of an evaluation."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.perception.data.frame_store import FrameStore
from laploop.perception.estimators import ESTIMATORS
from laploop.perception.messages import DepthEstimate
from laploop.studies.depth.config import DepthEvaluation
from laploop.studies.depth.evaluation import evaluate_depth

SIZE = (64, 64)
BARE = DepthEvaluation(floor_rows=())


class Stepwise:
    """Sees 100 mm everywhere; sure of the left half, where it marks valid, and half sure of the right: a slip or not, to it."""

    def __init__(self, rig):
        self.left = np.zeros(SIZE, bool)
        self.left[:, :32] = True

    def estimate(self, image):
        confidence = np.where(self.left, np.float32(0.95), np.float32(0.45))
        slip = np.where(self.left, np.float32(0.02), np.float32(0.5))
        return DepthEstimate(depth_mm=np.full(SIZE, 100.0, np.float32), valid=self.left, confidence=confidence, slip=slip)


@pytest.fixture
def stepwise():
    ESTIMATORS.register("stepwise", Stepwise)
    yield "stepwise"
    ESTIMATORS.unregister("stepwise")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Two tissues: 100.5 mm at the left, at the right 104 and 150 mm; the projector reaches the upper half."""
    path = tmp_path_factory.mktemp("data") / "frames"
    store = FrameStore.create(
        path,
        optics=ScopeOptics(width=64, height=64),
        tissue_seed=np.arange(2),
        split=np.full(2, 2, np.uint8),
        tool_in_view=np.zeros(2, bool),
        config={},
    )
    lit = np.zeros(SIZE, bool)
    lit[:32] = True
    for index, right_mm in enumerate((104.0, 150.0)):
        depth = np.full(SIZE, 100.5, np.float32)
        depth[:, 32:] = right_mm
        depth[:8, :8] = 150.0
        store.write(index, image=np.full(SIZE, 90, np.uint8), depth_mm=depth, lit=lit)
    return path


def test_lit_pixels_are_a_set_of_their_own(dataset, stepwise):
    row = evaluate_depth(dataset, [stepwise], progress=False, config=BARE).row(stepwise)
    counted = (64 * 64 - 64) + (64 * 32 - 64)
    assert row.every.pixels == counted
    assert row.lit.pixels == (32 * 64 - 64) + (32 * 32 - 64)
    assert row.lit_fraction == pytest.approx(row.lit.pixels / counted)
    lit_left = 2 * (32 * 32 - 64)
    assert row.lit.mae_mm == pytest.approx((0.5 * lit_left + 4.0 * 32 * 32) / row.lit.pixels)


def test_valid_pixels_are_counted_among_the_lit_ones(dataset, stepwise):
    table = evaluate_depth(dataset, [stepwise], progress=False, config=BARE)
    share = table.row(stepwise).lit_valid_share
    first, second = 32 * 64 - 64, 32 * 32 - 64  # lit pixels in the range; the model marks the left half valid
    assert share.value == pytest.approx(2 * second / (first + second))
    assert (share.low, share.high) == pytest.approx((second / first, 1.0))
    line = table.flat_rows()[0]
    assert [line[f"lit_valid_share{end}"] for end in ("", "_low", "_high")] == [share.value, share.low, share.high]


def test_nobody_knows_what_is_valid_of_no_lit_pixels(dataset, stepwise, monkeypatch):
    monkeypatch.setattr(FrameStore, "lit", lambda self, index: np.zeros(SIZE, bool))
    line = evaluate_depth(dataset, [stepwise], progress=False, config=BARE).flat_rows()[0]
    assert (line["lit_share"], line["lit_valid_share"], line["lit_valid_share_low"]) == (0.0, None, None)


def test_slips_count_what_is_marked_valid_outside_of_the_range(dataset, stepwise):
    row = evaluate_depth(dataset, [stepwise], progress=False, config=BARE).row(stepwise)
    assert row.valid.slips_per_1000 == pytest.approx(1000.0 * 64 / (64 * 32))
    assert math.isnan(row.every.slips_per_1000)
    assert row.valid_interval.low.slips_per_1000 == pytest.approx(row.valid.slips_per_1000)


def test_surfaces_and_edges_are_measured_on_each_set(dataset, stepwise):
    row = evaluate_depth(dataset, [stepwise], progress=False, config=BARE).row(stepwise)
    assert row.valid.plane_mm == pytest.approx(0.5)
    assert row.every.normal_deg == pytest.approx(0.0, abs=1e-4)
    assert (row.valid.edge_mae_mm, row.valid.away_mae_mm) == pytest.approx((0.5, 0.5))
    assert 0.5 < row.every.edge_mae_mm < row.every.away_mae_mm  # edges of the second tissue have no pixels of 4 mm error
    assert row.every_interval.low.edge_mae_mm <= row.every.edge_mae_mm <= row.every_interval.high.edge_mae_mm


def test_confidence_is_measured_where_there_is_one(dataset, stepwise, tmp_path):
    table = evaluate_depth(dataset, [stepwise, "oracle"], tmp_path, progress=False, config=BARE)
    (row,) = table.reliability_rows()
    assert (row["model"], row["against"], row["family"]) == (stepwise, "exact", "all")
    sure, unsure = (64 * 32 - 64) * 2, 64 * 32
    assert [part["pixels"] for part in row["tenths"]] == [0, 0, 0, 0, unsure, 0, 0, 0, 0, sure]
    assert (row["tenths"][4]["seen"], row["tenths"][9]["seen"]) == (0.0, 1.0)
    assert row["tenths"][0]["predicted"] is None
    assert row["calibration_error"] == pytest.approx((0.05 * sure + 0.45 * unsure) / (sure + unsure), abs=1e-6)
    share = sure / (sure + unsure)
    mean = 0.5 * share + 4.0 * (1.0 - share)
    assert row["risk_mm"][0] == pytest.approx(0.5)
    assert row["risk_mm"][9] == pytest.approx(mean)
    assert row["aurc_mm"] == pytest.approx(0.5 * share + mean * (1.0 - share))
    # By hand for draws of one tissue alone: half of the first is the unsure right, the second has the sure left alone.
    half = (32 * 64 - 64) / (64 * 64 - 64)
    alone = 0.5 * half + 4.0 * (1.0 - half)
    assert (row["aurc_mm_low"], row["aurc_mm_high"]) == pytest.approx((0.5, 0.5 * half + alone * (1.0 - half)))
    errors = (0.05, 0.05 * half + 0.45 * (1.0 - half))
    assert (row["calibration_error_low"], row["calibration_error_high"]) == pytest.approx(errors, abs=1e-6)
    assert json.loads((tmp_path / "depth.json").read_text())["reliability"] == table.reliability_rows()
    assert "## Confidence" in (tmp_path / "depth.md").read_text()


def test_slips_that_are_foreseen_are_compared_with_those_seen_at_any_depth(dataset, stepwise, tmp_path):
    table = evaluate_depth(dataset, [stepwise, "oracle"], tmp_path, progress=False, config=BARE)
    (row,) = table.reliability_rows()
    left, corner = 2 * 64 * 32, 2 * 64
    # The corners lie at 150 mm, and so does the right half of the second tissue.
    assert row["slips"]["valid"] == pytest.approx(
        {"pixels": left, "predicted": 0.02, "seen": corner / left, "seen_low": corner / left, "seen_high": corner / left}
    )
    whole = row["slips"]["all"]
    assert (whole["pixels"], whole["predicted"]) == (2 * left, pytest.approx(0.26))
    ends = (64 / 4096, (64 + 2048) / 4096)
    assert (whole["seen"], whole["seen_low"], whole["seen_high"]) == pytest.approx((sum(ends) / 2.0, *ends))
    assert [part["pixels"] for part in row["slips"]["bins"]] == [0, 0, left, 0, left, 0]
    assert row["slips"]["bins"][4]["seen"] == pytest.approx(0.5)
    assert "Predicted and seen slips" in (tmp_path / "depth.md").read_text()


def test_of_a_confidence_alone_no_slips_are_told(dataset, stepwise, monkeypatch):
    seen = Stepwise.estimate
    monkeypatch.setattr(Stepwise, "estimate", lambda self, image: replace(seen(self, image), slip=None))
    (row,) = evaluate_depth(dataset, [stepwise], progress=False, config=BARE).reliability_rows()
    assert row["slips"] is None


def test_families_have_lines_where_there_are_several(dataset, stepwise, tmp_path, monkeypatch):
    one = evaluate_depth(dataset, [stepwise], progress=False, config=BARE)
    assert one.family_rows == ()
    monkeypatch.setattr(FrameStore, "family", lambda self, index: ("liver", "bowel")[index])
    table = evaluate_depth(dataset, [stepwise], tmp_path, progress=False, config=BARE)
    assert table.rows == one.rows
    found = {row.family: row for row in table.family_rows}
    assert sorted(found) == ["bowel", "liver"]
    assert found["liver"].frames == 1
    assert found["liver"].every.mae_mm > found["bowel"].every.mae_mm == pytest.approx(0.5)
    assert found["liver"].every.pixels + found["bowel"].every.pixels == table.row(stepwise).every.pixels
    written = json.loads((tmp_path / "depth.json").read_text())
    assert [row["family"] for row in written["families"]] == ["bowel", "liver"]
    assert {row["family"] for row in written["rows"]} == {"all"}
    assert "By family of shapes" in (tmp_path / "depth.md").read_text()


def test_confidence_has_rows_by_family_where_there_are_several(dataset, stepwise, tmp_path, monkeypatch):
    (one,) = evaluate_depth(dataset, [stepwise], progress=False, config=BARE).reliability_rows()
    monkeypatch.setattr(FrameStore, "family", lambda self, index: ("liver", "bowel")[index])
    table = evaluate_depth(dataset, [stepwise], tmp_path, progress=False, config=BARE)
    whole, bowel, liver = table.reliability_rows()
    assert whole == one
    assert (bowel["family"], liver["family"]) == ("bowel", "liver")
    assert bowel["aurc_mm"] == pytest.approx(0.5)
    assert bowel["aurc_mm_low"] is None  # a family of one tissue
    for place, part in enumerate(whole["tenths"]):
        assert part["pixels"] == bowel["tenths"][place]["pixels"] + liver["tenths"][place]["pixels"]
    assert "| stepwise | exact | liver |" in (tmp_path / "depth.md").read_text()


def test_textures_have_lines_where_there_are_several(dataset, stepwise, tmp_path, monkeypatch):
    one = evaluate_depth(dataset, [stepwise], progress=False, config=BARE)
    assert one.texture_rows == ()
    monkeypatch.setattr(FrameStore, "texture", lambda self, index: ("blood", "plain")[index])
    table = evaluate_depth(dataset, [stepwise], tmp_path, progress=False, config=BARE)
    assert (table.rows, table.family_rows) == (one.rows, ())
    assert [(row.texture, row.family, row.frames) for row in table.texture_rows] == [("blood", "all", 1), ("plain", "all", 1)]
    written = json.loads((tmp_path / "depth.json").read_text())
    assert [row["texture"] for row in written["textures"]] == ["blood", "plain"]
    assert "By texture" in (tmp_path / "depth.md").read_text()


def test_every_measure_has_its_interval_in_the_flat_lines(dataset, stepwise):
    line = evaluate_depth(dataset, [stepwise], progress=False, config=BARE).flat_rows()[0]
    for prefix in ("", "valid_", "lit_"):
        for name in ("mae_mm", "sq_rel_mm", "acc_1_331", "acc_1_953", "beyond_3mm", "plane_mm", "normal_deg", "away_mae_mm"):
            low, value, high = (line[f"{prefix}{name}{end}"] for end in ("_low", "", "_high"))
            assert low <= value <= high, prefix + name
