from dataclasses import replace

import numpy as np
import pytest

from laploop.assets.stripe_mask import StripeMask
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.optics.presets import PRESETS, OpticsRanges, draw_light, optics_preset, randomised_surfaces
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.errors import InvalidValueError, UnknownNameError
from laploop.studies.scenes.frame_conditions import FrameRanges, draw_optics


@pytest.fixture(scope="module")
def clear_camera(rig):
    return StripeCamera(replace(rig, mask=StripeMask(profile=(1.0,))))


def test_paper_is_the_default_everywhere():
    assert optics_preset("paper") == StripeOptics()


def test_unknown_preset_lists_what_exists():
    with pytest.raises(UnknownNameError, match="ideal, paper, worst"):
        optics_preset("best")


@pytest.mark.parametrize("name", PRESETS)
def test_noise_of_every_preset_follows_the_photon_transfer_curve(clear_camera, make_plane, name):
    optics = optics_preset(name)
    clear_camera.attach_geometry(make_plane(0.09))
    rng = np.random.default_rng(5)
    electrons_per_level = optics.full_well_electrons / 255.0
    for light in (0.15, 0.4, 0.8):
        clear_camera.set_optics(replace(optics, led_power_w=light * optics.led_power_w))
        captures = [clear_camera.capture(None, np.eye(4), rng) for _ in range(6)]
        mean = captures[0].electrons.astype(float)
        band = (mean > 0.02 * optics.full_well_electrons) & (mean < 0.9 * optics.full_well_electrons)
        assert band.sum() > 20000
        images = np.stack([capture.image for capture in captures])[:, band] * electrons_per_level
        # About the true mean: rounding adds a twelfth of a squared level however small the noise is.
        variance = np.mean((images - mean[band]) ** 2)
        expected = np.mean(mean[band]) + optics.read_noise_electrons**2 + electrons_per_level**2 / 12.0
        # 120000 samples leave a statistical error of 0.4 %.
        assert variance == pytest.approx(expected, rel=0.03)
        assert images.mean() == pytest.approx(mean[band].mean(), rel=0.002)


def test_presets_order_by_contrast_and_noise(camera, make_plane):
    contrast, noise = {}, {}
    camera.attach_geometry(make_plane(0.085, object_id=ObjectId.TISSUE))
    for name in ("ideal", "paper", "worst"):
        camera.set_optics(optics_preset(name))
        clean = camera.capture(None, np.eye(4), None)
        row = clean.electrons[60, 78:178]
        contrast[name] = np.ptp(row) / (row.max() + row.min())
        noisy = camera.capture(None, np.eye(4), np.random.default_rng(0)).image.astype(float)
        noise[name] = (noisy - clean.image)[40:80, 78:178].std() / clean.image[40:80, 78:178].mean()
        assert clean.image[40:216, 40:216].mean() > 20.0  # lit well enough to work with
    camera.set_optics(StripeOptics())
    assert contrast["ideal"] > 0.99 > contrast["paper"] > contrast["worst"] > 0.15
    assert noise["ideal"] < 0.5 * noise["paper"] < 0.5 * noise["worst"]


def test_same_seed_draws_the_same_optics_inside_the_ranges():
    ranges, optics = OpticsRanges(), optics_preset("paper")
    draws = [randomised_surfaces(optics, np.random.default_rng(seed), ranges) for seed in range(40)]
    assert draws[3] == randomised_surfaces(optics, np.random.default_rng(3), ranges)
    assert len(set(draws)) == 40
    for values, (low, high) in (
        ([draw_light(np.random.default_rng(seed), ranges) for seed in range(40)], ranges.light),
        ([d.tissue.albedo for d in draws], ranges.tissue_albedo),
        ([d.tissue.roughness for d in draws], ranges.tissue_roughness),
        ([d.read_noise_electrons for d in draws], ranges.read_noise_electrons),
        ([d.glare_fraction for d in draws], ranges.glare_fraction),
    ):
        assert low <= min(values) < max(values) <= high
        assert max(values) - min(values) > 0.7 * (high - low)


def test_optics_without_a_range_keep_their_values():
    optics = replace(optics_preset("worst"), exposure_s=0.004, f_number=5.6)
    drawn = randomised_surfaces(optics, np.random.default_rng(0), OpticsRanges())
    assert (drawn.exposure_s, drawn.f_number, drawn.other, drawn.bits) == (0.004, 5.6, optics.other, 8)


def test_other_lights_are_drawn_only_where_a_range_is_given():
    optics = optics_preset("paper")
    without = randomised_surfaces(optics, np.random.default_rng(0), OpticsRanges())
    drawn = randomised_surfaces(optics, np.random.default_rng(0), OpticsRanges(ambient_w_m2=(0.5, 2.0)))
    assert without.ambient_w_m2 == 0.0
    assert 0.5 <= drawn.ambient_w_m2 <= 2.0
    assert replace(drawn, ambient_w_m2=0.0) == without


def test_training_frames_draw_what_the_shipped_weights_saw():
    optics = draw_optics(FrameRanges(), 0.09, np.random.default_rng(0))
    # The first draws of the data sets from which the shipped weights were trained.
    assert optics.led_power_w == pytest.approx(0.04465124452950589, rel=1e-12)
    assert optics.full_well_electrons == pytest.approx(11639.81465460308, rel=1e-12)
    assert optics.stage.albedo == pytest.approx(0.064701980542765, rel=1e-12)


@pytest.mark.parametrize(
    ("field", "span"), [("light", (2.0, 1.0)), ("light", (0.0, 1.0)), ("tissue_albedo", (0.3, 1.2)), ("glare_fraction", (0.1,))]
)
def test_empty_and_impossible_ranges_are_refused_by_name(field, span):
    with pytest.raises(InvalidValueError, match=field):
        OpticsRanges(**{field: span})
