"""The check finds stripes, and takes nothing else in a picture for stripes, nor stripes for those of another calibration."""

import json
import math

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.errors import InvalidValueError
from laploop.perception.calibration.scope_rig import save_design
from laploop.perception.pictures.predictor import NO_STRIPES, PicturePredictor
from laploop.perception.stripe_check import StripeCheck, StripeCheckConfig


def _grey(values):
    return np.clip(np.round(values), 0, 255).astype(np.uint8)


def _text(scale, step, words):
    page = np.full((256, 256), 235, np.uint8)
    for number, row in enumerate(range(step, 256, step)):
        place = (2, row)
        cv2.putText(page, words[number % 5 :], place, cv2.FONT_HERSHEY_SIMPLEX, scale, 20, round(2 * scale + 0.3), cv2.LINE_AA)
    return page


def pictures_without_stripes(stripes=20, seed=0):
    """Return pictures by name, 256 x 256, for a rig of so many stripes."""
    size = 256
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:size, :size] + 0.5
    noise = rng.standard_normal((size, size))
    radius = np.hypot(x - 128.0, y - 128.0)
    wave = 2.0 * np.pi * stripes / size

    def texture(sigma):
        blurred = gaussian_filter(noise, sigma)
        return _grey(128.0 + 50.0 * blurred / blurred.std())

    def spectrum(gain):
        shaped = np.fft.irfft2(np.fft.rfft2(noise) * gain)
        return _grey(128.0 + 50.0 * (shaped - shaped.mean()) / shaped.std())

    frequency = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size))
    spots = np.zeros((size, size))
    spots[rng.integers(size, size=200), rng.integers(size, size=200)] = 1.0
    spots = gaussian_filter(spots, 4.0)
    ideal = 20.0 + 180.0 * ((x * stripes / size) % 1.0 < 0.5)
    made = {
        "black": _grey(0.0 * x),
        "white": _grey(0.0 * x + 255.0),
        "constant": _grey(0.0 * x + 128.0),
        "dark noise": _grey(3.0 + 2.0 * noise),
        "weak noise": _grey(128.0 + 5.0 * noise),
        "strong noise": _grey(128.0 + 80.0 * noise),
        "uniform noise": rng.integers(0, 256, (size, size), dtype=np.uint8),
        "gradient along x": _grey(x),
        "gradient along y": _grey(y),
        "radial gradient": _grey(255.0 - radius),
        "natural spectrum": spectrum(1.0 / np.maximum(frequency, 1.0 / size)),
        "waves of the stripes' length": spectrum(np.exp(-0.5 * ((frequency * size / stripes - 1.0) / 0.15) ** 2)),
        "horizontal stripes": ideal.T.astype(np.uint8),
        "horizontal cosine": _grey(128.0 + 100.0 * np.cos(wave * y)),
        "oblique cosine": _grey(128.0 + 100.0 * np.cos(wave * (0.5 * x + 0.87 * y))),
        "stripes out of focus": _grey(gaussian_filter(ideal, 8.0)),
        "saturated": _grey(255.0 - 30.0 * (rng.random((size, size)) < 0.02)),
        "rings": _grey(128.0 + 100.0 * np.cos(wave * radius)),
        "fan": _grey(128.0 + 100.0 * np.cos(40.0 * np.arctan2(y - 128.0, x - 128.0))),
        "highlights": _grey(40.0 + 215.0 * np.minimum(2.0 * spots / spots.max(), 1.0)),
        "small text": _text(0.4, 15, "the quick brown fox jumps over lllllliiiiii 0123"),
        "large text": _text(0.7, 24, "MMMIIIIHHHIIIHHHHHHIII"),
        "tissue without stripes": _grey(90.0 + 25.0 * (texture(6.0) - 128.0) / 50.0 - 0.25 * radius + 3.0 * noise),
    }
    made |= {f"texture {sigma:g}": texture(sigma) for sigma in (1.5, 3.0, 5.0, 8.0)}
    made |= {f"checkerboard {side}": _grey(20.0 + 200.0 * ((x // side + y // side) % 2)) for side in (4, 6, 8, 16, 32)}
    for count in (5, 10, 17, 23, 24, 40):
        made[f"{count} stripes"] = _grey(20.0 + 180.0 * ((x * count / size) % 1.0 < 0.5))
    made |= {f"{count} cosine stripes": _grey(128.0 + 100.0 * np.cos(2.0 * np.pi * count * x / size)) for count in (10, 24)}
    return made


PICTURES = pictures_without_stripes()


def scenes(rig, sphere_depth):
    """Return depth in metres and albedo of surfaces that fill the view, by name."""
    x, y = rig.camera.rays[..., 0], rig.camera.rays[..., 1]
    made = {f"plane at {mm} mm": (np.full(x.shape, 1e-3 * mm), 1.0) for mm in (60, 100, 140)}
    made["tilted plane"] = 0.09 / (1.0 - math.tan(math.radians(30.0)) * x), 1.0
    made["ball"] = sphere_depth(rig)[0], 1.0
    lobes = 0.085 + 0.006 * np.sin(16.0 * x + 5.0 * y) * np.cos(14.0 * y) + 0.01 * y
    rng = np.random.default_rng(5)
    mottled = np.exp(3.0 * gaussian_filter(rng.standard_normal(x.shape), 5.0))
    made["mottled lobes"] = lobes, mottled
    tool = np.abs(y - 0.5 * x + 0.05) < 0.07 * (x > -0.1)
    made["lobes behind a tool"] = np.where(tool, 0.065, lobes), np.where(tool, 0.3, mottled)
    return made


def _mask(stripes):
    return ScopeOptics(mask=StripeMask(stripes=stripes))


def _focal(content, factor):
    for name in ("fx", "fy"):
        content["cameras"]["scope"][name] *= factor


WRONG_CALIBRATIONS = {f"{stripes} stripes": (_mask(stripes), 1.0) for stripes in (10, 14, 17, 24, 28, 40)}
WRONG_CALIBRATIONS |= {
    f"{factor:g} times the focal length": (ScopeOptics(), factor) for factor in (0.5, 0.7, 0.8, 1.2, 1.3, 2.0)
}
TURNED = {"a quarter": np.rot90, "a quarter back": lambda picture: np.rot90(picture, -1), "swapped axes": np.transpose}


@pytest.fixture(scope="module")
def check(rig):
    return StripeCheck(rig)


def test_there_are_thirty_kinds_of_pictures_without_stripes():
    assert len(PICTURES) >= 30


@pytest.mark.parametrize("name", PICTURES)
def test_no_stripes_are_found_where_there_are_none(check, name):
    assert not check.find(PICTURES[name]).present


@pytest.mark.parametrize(("model", "every"), [("compact", 1), ("ssle-phase", 3), ("phase", 1)])
def test_no_pixel_of_a_picture_without_stripes_is_valid(tmp_path, model, every):
    save_design(tmp_path / "scope.json", ScopeOptics())
    predictor = PicturePredictor(tmp_path / "scope.json", model)
    claimed = 0
    for name, picture in list(PICTURES.items())[::every]:
        found = predictor.predict(picture)
        assert not found.valid.any(), name
        assert np.isnan(found.depth_mm).all()
        assert found.note == NO_STRIPES
        claimed += bool(predictor._estimator.estimate(picture).valid.any())
    # Without the check, estimators mark pixels of some of these valid, the classical method those of several.
    assert claimed >= (4 if model == "phase" else 1)


@pytest.mark.parametrize("depth_m", [0.06, 0.1, 0.14])
@pytest.mark.parametrize(("bright", "dark"), [(150.0, 15.0), (6.0, 1.0), (400.0, 40.0)])
def test_stripes_are_found_on_a_noisy_plane_in_any_light(rig, render, check, depth_m, bright, dark):
    image = render(rig, np.full((256, 256), depth_m), rng=np.random.default_rng(1), bright=bright, dark=dark)
    found = check.find(image)
    assert found.present
    assert found.fraction > 0.3
    assert found.drift_turns < 0.02


def _predictor(folder, model, optics, factor=1.0, baseline=1.0):
    path = folder / "scope.json"
    save_design(path, optics)
    content = json.loads(path.read_text())
    _focal(content, factor)
    content["projector"]["projector_from_camera"][0][3] *= baseline
    path.write_text(json.dumps(content))
    return PicturePredictor(path, model)


@pytest.fixture(scope="module")
def striped_pictures(rig, render, sphere_depth):
    """Pictures of `scenes` in any light, by name."""
    rng = np.random.default_rng(2)
    lights = {"usual": (150.0, 15.0), "weak": (8.0, 1.0), "too much": (400.0, 40.0)}
    return {
        f"{name} in {light} light": render(rig, depth_m, rng=rng, bright=bright, dark=dark, albedo=albedo)
        for name, (depth_m, albedo) in scenes(rig, sphere_depth).items()
        for light, (bright, dark) in lights.items()
    }


def test_stripes_are_found_on_all_surfaces_in_any_light(striped_pictures, check):
    for name, picture in striped_pictures.items():
        assert check.find(picture).present, name


@pytest.mark.parametrize("model", ["phase", "compact", "ssle-phase"])
@pytest.mark.parametrize("calibration", WRONG_CALIBRATIONS)
def test_no_pixel_is_valid_under_a_calibration_of_another_pitch(tmp_path, striped_pictures, model, calibration):
    predictor = _predictor(tmp_path, model, *WRONG_CALIBRATIONS[calibration])
    for name, picture in list(striped_pictures.items())[:: 1 if model == "phase" else 4]:
        found = predictor.predict(picture)
        assert not found.valid.any(), name
        assert found.note == NO_STRIPES


@pytest.mark.parametrize("turned", TURNED)
def test_no_stripes_are_found_in_a_picture_turned_by_a_quarter(striped_pictures, check, turned):
    for name, picture in striped_pictures.items():
        assert not check.find(np.ascontiguousarray(TURNED[turned](picture))).present, name


@pytest.mark.parametrize(
    ("optics", "baseline"), [(ScopeOptics(mask=StripeMask(phase=0.5)), 1.0), (ScopeOptics(), 2.0), (ScopeOptics(), 0.5)]
)
def test_a_calibration_of_the_same_pitch_is_not_told_from_the_right_one(tmp_path, rig, render, check, optics, baseline):
    picture = render(rig, np.full((256, 256), 0.1), rng=np.random.default_rng(3))
    found = _predictor(tmp_path, "phase", optics, baseline=baseline).predict(picture)
    np.testing.assert_array_equal(found.stripes.striped, check.find(picture).striped)
    assert found.stripes.present
    # Nothing in the picture contradicts the wrong depth.
    assert abs(np.median(found.raw_depth_mm[100:150, 100:150]) - 100.0) > 20.0


def test_a_mirrored_picture_is_not_told_from_one_that_is_not(striped_pictures, check):
    picture = striped_pictures["ball in usual light"]
    for mirrored in (picture[:, ::-1], picture[::-1], picture[::-1, ::-1]):
        assert check.find(np.ascontiguousarray(mirrored)).present


@pytest.mark.parametrize("axis", [0, 1])
def test_drift_of_a_tilted_plane_is_that_of_the_formula(rig, render, check, axis):
    distance, slope = 0.09, np.tan(np.radians(40.0))
    depth_m = distance / (1.0 - slope * rig.camera.rays[..., axis])
    found = check.find(render(rig, np.clip(depth_m, 0.05, 0.5)))
    assert found.present
    # 1 / Z is linear in the image: the drift is b tan(slope) / Z of the plane's middle, whatever the pixel.
    assert found.drift_turns == pytest.approx(rig.baseline_m * slope / distance, rel=0.15)


def test_stripes_of_a_part_of_the_view_suffice_and_are_located(rig, render, check):
    image = np.full((256, 256), 90, np.uint8)
    image[100:220, 60:180] = render(rig, np.full((256, 256), 0.1))[100:220, 60:180]
    found = check.find(image)
    assert found.present
    assert found.striped[120:200, 90:150].mean() > 0.95
    assert not found.striped[:70].any()


def test_another_size_and_impossible_thresholds_are_refused(check):
    with pytest.raises(InvalidValueError, match=r"\(height, width\) = \(256, 256\)"):
        check.find(np.zeros((64, 64), np.uint8))
    with pytest.raises(InvalidValueError, match="min_fraction is 2"):
        StripeCheckConfig(min_fraction=2.0)
