import csv
import io
from dataclasses import replace

import numpy as np
import pytest

from laploop.assets.dof_target import DepthOfFieldTarget
from laploop.assets.scope_optics import ScopeOptics
from laploop.errors import InvalidValueError, UnknownNameError
from laploop.perception.geometry import Rig
from laploop.studies.characterization.config import CharacterizationConfig
from laploop.studies.characterization.figure import draw_characterization
from laploop.studies.characterization.run import (
    as_csv,
    as_markdown,
    characterise,
    find_extrema,
    measure_profile,
    michelson_contrast,
    profiles_as_csv,
    scale_of_columns,
)


@pytest.fixture(scope="module")
def paper():
    return characterise(CharacterizationConfig())


def test_contrast_is_that_of_the_real_scope(paper):
    assert paper.at(70).contrast == pytest.approx(0.58, abs=0.03)
    assert paper.at(100).contrast == pytest.approx(0.44, abs=0.03)


def test_contrast_and_brightness_fall_with_distance(paper):
    contrast = [paper.at(distance).contrast for distance in range(60, 141, 10)]
    assert (np.diff(contrast) < 0.0).all()
    intensity = [profile.mean_intensity for profile in paper.profiles]
    assert (np.diff(intensity) < 0.0).all()


def test_stripes_are_resolved_at_both_distances(paper):
    for distance in (70, 100):
        profile = paper.at(distance)
        assert len(profile.peaks) >= 4
        depth = profile.mean[profile.peaks].min() - profile.mean[profile.valleys].max()
        assert depth > 5.0 * profile.spread.mean()


def test_nothing_in_the_regions_saturates(paper):
    for profile in paper.profiles:
        roi = profile.roi
        assert profile.image[roi.top : roi.bottom, roi.left : roi.right].max() < 255


def test_peaks_lie_where_the_projector_put_them(paper):
    rig, target = Rig.from_optics(ScopeOptics()), DepthOfFieldTarget()
    profile = paper.at(70)
    # A bright stripe's middle x_p meets the inclined plane where x_p z = x - b.
    middles = -rig.mask.half_width_tan + rig.mask.period_tan * (np.arange(20) + 0.25)
    slope, distance = np.tan(target.tilt_rad), 0.070
    x = (middles * distance + rig.baseline_m) / (1.0 - middles * slope)
    scale = 1e3 * x / np.cos(target.tilt_rad) + target.centre_mm
    for peak in profile.scale_mm[profile.peaks]:
        # A column is 0.3 to 0.7 mm of the scale wide, and the fall of the brightness draws peaks to the bright side.
        assert np.abs(scale - peak).min() < 0.8


def test_ideal_optics_keep_the_whole_contrast_and_the_worst_lose_a_little_more():
    near = CharacterizationConfig(distances_mm=(70,))
    ideal, worst = (characterise(replace(near, preset=name)) for name in ("ideal", "worst"))
    assert ideal.at(70).contrast > 0.99
    assert ideal.at(100).contrast > 0.99
    assert worst.at(70).contrast == pytest.approx(0.53, abs=0.03)
    assert worst.at(100).contrast == pytest.approx(0.39, abs=0.03)


def test_same_seed_measures_the_same():
    config = CharacterizationConfig(distances_mm=(70,), seed=4)
    first, again, other = (characterise(c) for c in (config, config, replace(config, seed=5)))
    np.testing.assert_array_equal(first.at(70).image, again.at(70).image)
    assert first.as_dict() == again.as_dict()
    assert first.at(70).contrast != other.at(70).contrast


def test_columns_meet_the_scale_where_the_target_is():
    rig, target = Rig.from_optics(ScopeOptics()), DepthOfFieldTarget()
    along = np.array([-20.0, -3.0, 0.0, 7.5, 20.0])
    points = target.camera_from_target(0.08) @ np.stack([1e-3 * along, 0 * along, 0 * along, 1 + 0 * along])
    u = rig.camera.project(points[:3].T)[:, 0]
    np.testing.assert_allclose(scale_of_columns(rig.camera, target, 80, u), along + 25.0, atol=1e-9)


@pytest.mark.parametrize("contrast", [0.1, 0.44, 0.9])
def test_contrast_of_a_known_wave_is_found_whatever_the_brightness_does(contrast):
    x = np.arange(200.0)
    wave = 100.0 * (1.0 + contrast * np.cos(2.0 * np.pi * x / 20.0))
    assert michelson_contrast(wave, *find_extrema(wave, 12.0)) == pytest.approx(contrast, rel=1e-9)
    falling = wave * np.exp(-x / 150.0)
    assert michelson_contrast(falling, *find_extrema(falling, 12.0)) == pytest.approx(contrast, abs=0.012)


def test_a_profile_without_stripes_has_no_contrast():
    flat = np.linspace(100.0, 50.0, 60)
    assert np.isnan(michelson_contrast(flat, *find_extrema(flat, 8.0)))
    rig = Rig.from_optics(ScopeOptics())
    dark = measure_profile(np.zeros((256, 256), dtype=np.uint8), rig, DepthOfFieldTarget(), 70)
    assert np.isnan(dark.contrast)
    assert dark.mean_intensity == 0.0


def test_tables_hold_every_distance(paper):
    rows = list(csv.DictReader(io.StringIO(as_csv(paper))))
    assert [int(row["distance_mm"]) for row in rows] == list(range(50, 151, 10))
    assert float(rows[2]["contrast"]) == pytest.approx(paper.at(70).contrast, abs=1e-4)
    assert len(as_markdown(paper).splitlines()) == 2 + 11
    columns = list(csv.DictReader(io.StringIO(profiles_as_csv(paper))))
    assert len(columns) == sum(len(profile.mean) for profile in paper.profiles)


def test_figure_is_drawn(paper, tmp_path):
    draw_characterization(paper, "title", tmp_path / "figure.png")
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")


def test_impossible_configuration_is_refused():
    with pytest.raises(UnknownNameError, match="preset"):
        CharacterizationConfig(preset="best")
    with pytest.raises(InvalidValueError, match="distances_mm"):
        CharacterizationConfig(distances_mm=(10,))
    with pytest.raises(InvalidValueError, match="seed"):
        CharacterizationConfig(seed=-1)


def test_a_target_out_of_view_is_refused():
    narrow = CharacterizationConfig(optics=ScopeOptics(fov_rad=0.3))
    with pytest.raises(InvalidValueError, match="in view"):
        characterise(narrow)
