import csv
import math

import numpy as np
import pytest
from scipy.ndimage import minimum_filter, uniform_filter, uniform_filter1d

from laploop.assets.scope_optics import ScopeOptics
from laploop.errors import InvalidValueError, UnknownNameError
from laploop.studies.depth.config import RobustnessConfig
from laploop.studies.depth.robustness import SURROUNDINGS, measure_robustness, write_robustness
from laploop.studies.depth.robustness_scenes import CONDITIONS, PHASE_SHIFT, robustness_frames

TINY = RobustnessConfig(tissues=2, frames_per_tissue=2, seed=3)


@pytest.fixture(scope="module")
def frames():
    found = {name: [] for name in CONDITIONS}
    for frame in robustness_frames(TINY, ScopeOptics()):
        found[frame.condition].append(frame)
    return found


def test_every_condition_has_as_many_frames(frames):
    assert {len(found) for found in frames.values()} == {TINY.frames}
    assert [frame.tissue for frame in frames["nominal"]] == [0, 0, 1, 1]


def test_conditions_change_what_they_say_and_nothing_else(frames):
    for number, nominal in enumerate(frames["nominal"]):
        half, shifted = frames["half power"][number], frames["phase shifted"][number]
        np.testing.assert_array_equal(half.depth_mm, nominal.depth_mm)
        np.testing.assert_array_equal(shifted.depth_mm, nominal.depth_mm)
        assert half.image.mean() == pytest.approx(0.5 * nominal.image.mean(), abs=1.0)  # grey value; rounding and clipping
        assert shifted.rig.mask.phase == pytest.approx(nominal.rig.mask.phase + PHASE_SHIFT)
        assert half.rig == nominal.rig
        assert not np.array_equal(shifted.image, nominal.image)


def test_tissue_of_another_family_has_another_shape(frames):
    for nominal, other in zip(frames["nominal"], frames["other tissue"], strict=True):
        both = np.isfinite(nominal.depth_mm) & np.isfinite(other.depth_mm)
        assert np.abs(nominal.depth_mm - other.depth_mm)[both].mean() > 0.3  # mm


def test_tool_covers_about_a_third_of_the_view(frames):
    for nominal, tool in zip(frames["nominal"], frames["tool in view"], strict=True):
        in_front = np.nan_to_num(nominal.depth_mm, nan=1e3) - np.nan_to_num(tool.depth_mm, nan=1e3) > 3.0
        assert 0.25 < in_front.mean() < 0.35


def test_four_pixels_in_ten_are_lost_by_turns_to_too_much_and_too_little_light(frames):
    for number, frame in enumerate(frames["saturated or dark"]):
        hit = np.isfinite(frame.depth_mm)
        lost = frame.image <= 2 if number % 2 else frame.image >= 254
        # Grey values are whole and noisy: those next to the threshold fall to either side of it.
        assert 0.33 < lost[hit].mean() < 0.47


def test_tissues_and_other_lights_change_the_contrast_alone(frames):
    def contrast(frame):
        lit = frame.lit & (frame.depth_mm < 110.0)
        return _swing(frame.image)[lit].mean() / frame.image[lit].mean()

    for number, nominal in enumerate(frames["nominal"]):
        liver, fat, lamp = (frames[name][number] for name in ("liver", "fat", "ambient light"))
        for frame in (liver, fat, lamp):
            np.testing.assert_array_equal(frame.depth_mm, nominal.depth_mm)
        assert fat.image[nominal.lit].mean() == pytest.approx(nominal.image[nominal.lit].mean(), rel=0.1)
        assert contrast(fat) < 0.9 * contrast(nominal)
        assert contrast(lamp) < 0.95 * contrast(nominal)
        assert lamp.image.astype(int).sum() > nominal.image.astype(int).sum()


def test_no_brightness_is_left_without_shading(frames):
    for nominal, bare in zip(frames["nominal"], frames["no shading"], strict=True):
        # Averaged over more than a period, what is left of the stripes is the same everywhere.
        seen = minimum_filter(bare.lit, 31)
        usual, flat = (uniform_filter(frame.image.astype(float), 27)[seen] for frame in (nominal, bare))
        assert np.std(flat) / np.mean(flat) < 0.25 * np.std(usual) / np.mean(usual)
        assert _swing(bare.image)[seen].mean() > 0.2 * np.mean(flat)


def _swing(image):
    """Standard deviation along the rows over about a period, by pixel."""
    grey = image.astype(float)
    mean = uniform_filter1d(grey, 13)
    return np.sqrt(np.maximum(uniform_filter1d(grey**2, 13) - mean**2, 0.0))


def test_frames_are_the_same_each_time_and_others_with_another_seed(frames):
    again = next(robustness_frames(TINY, ScopeOptics()))
    np.testing.assert_array_equal(again.image, frames["nominal"][0].image)
    other = next(robustness_frames(RobustnessConfig(tissues=1, frames_per_tissue=1, seed=4), ScopeOptics()))
    assert not np.array_equal(other.image, again.image)


def test_rows_say_how_much_worse_each_condition_is(tmp_path):
    config = RobustnessConfig(tissues=1, frames_per_tissue=2, seed=3)
    rows = measure_robustness(["oracle", "phase"], ScopeOptics(), config=config, progress=False)
    assert [(row.model, row.condition) for row in rows] == [
        (model, condition) for model in ("oracle", "phase", SURROUNDINGS) for condition in CONDITIONS
    ]
    by_key = {(row.model, row.condition): row for row in rows}
    for condition in CONDITIONS:
        oracle = by_key["oracle", condition]
        assert (oracle.every.mae_mm, oracle.valid_fraction) == (0.0, 1.0)
        assert oracle.every.pixels > 0
        assert by_key["phase", condition].every.pixels == oracle.every.pixels
    nominal, lost = by_key["phase", "nominal"], by_key["phase", "saturated or dark"]
    assert nominal.ratio == nominal.valid_ratio == 1.0
    assert lost.ratio == pytest.approx(lost.every.mae_mm / nominal.every.mae_mm)
    assert lost.valid_fraction < nominal.valid_fraction
    shadowed = by_key["phase", "tool in view"]
    assert shadowed.lit.pixels / shadowed.every.pixels < nominal.lit.pixels / nominal.every.pixels
    assert shadowed.lit.mae_mm < shadowed.every.mae_mm
    assert nominal.same_ratio == 1.0
    # Nothing but the light has changed, so that the same pixels are those that are lit.
    assert lost.same_ratio == pytest.approx(lost.lit_ratio, rel=1e-3)
    assert math.isnan(by_key["phase", "other tissue"].same_ratio)
    # The tool hides pixels, and not the average ones.
    assert shadowed.same_ratio > 0.0
    assert shadowed.same_ratio != pytest.approx(shadowed.lit_ratio, rel=1e-3)
    hidden = by_key[SURROUNDINGS, "tool in view"]
    assert hidden.lit.mae_mm < 1e-3  # mm; float32
    assert by_key[SURROUNDINGS, "nominal"].every.mae_mm < hidden.every.mae_mm
    write_robustness(rows, tmp_path)
    with (tmp_path / "robustness.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == len(rows)
    assert float(lines[-1]["valid_share"]) == pytest.approx(rows[-1].valid_fraction)
    assert "| phase | tool in view | 2 |" in (tmp_path / "robustness.md").read_text()


def test_impossible_input_is_refused_before_any_frame_is_rendered():
    with pytest.raises(UnknownNameError, match="guess"):
        measure_robustness(["guess"], ScopeOptics(), progress=False)
    with pytest.raises(InvalidValueError, match="models"):
        measure_robustness([], ScopeOptics(), progress=False)
    for change in ({"tissues": 0}, {"frames_per_tissue": 0}, {"seed": -1}):
        with pytest.raises(InvalidValueError):
            RobustnessConfig(**change)
