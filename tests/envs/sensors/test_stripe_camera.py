"""Stripes, light, noise, lens and output of the stripe camera, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from laploop.assets.stripe_mask import StripeMask
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.envs.sensors.tracing.scene_geometry import SceneGeometry
from laploop.errors import InvalidValueError
from laploop.perception.estimators.base import check_image, to_eight_bits

AT_ORIGIN = np.eye(4)
WITHOUT_STRAY_LIGHT = StripeOptics(glare_fraction=0.0, cavity_fraction=0.0)
NOMINAL_ROW = [
    87,
    66,
    51,
    42,
    44,
    53,
    67,
    83,
    97,
    108,
    108,
    105,
    90,
    72,
    56,
    44,
    40,
    44,
    54,
    71,
    84,
    96,
    105,
    102,
    93,
    78,
    62,
    50,
    41,
    40,
    46,
    60,
]
"""Grey values of the nominal light: a change that is not one of the physics keeps them."""


@pytest.fixture(scope="module")
def flat_camera(rig):
    """The same scope with a mask that is clear over nineteen twentieths of its field."""
    return StripeCamera(replace(rig, mask=StripeMask(stripes=1, duty=0.95)), WITHOUT_STRAY_LIGHT)


@pytest.fixture(autouse=True)
def _nominal_optics(camera, flat_camera):
    camera.set_optics(StripeOptics())
    flat_camera.set_optics(WITHOUT_STRAY_LIGHT)


@pytest.fixture(scope="module")
def clear_camera(rig):
    return StripeCamera(replace(rig, mask=StripeMask(profile=(1.0,))), WITHOUT_STRAY_LIGHT)


def step_scene(make_plane):
    """A bright card before nothing, its edge along y in the middle of the image."""
    card = make_plane(0.09, half=0.2)
    card.points[:, 0] = np.where(card.points[:, 0] < 0.0, -0.2, 0.0)
    return SceneGeometry(points=card.points, triangles=card.triangles, object_ids=ObjectId.OTHER)


def michelson(profile):
    """Contrast of a stripe profile, from the means of its peaks and of its troughs."""
    inner, left, right = profile[1:-1], profile[:-2], profile[2:]
    high = inner[(inner >= left) & (inner > right)].mean()
    low = inner[(inner <= left) & (inner < right)].mean()
    return (high - low) / (high + low)


def plane_contrast(camera, plane):
    camera.attach_geometry(plane)
    electrons = camera.capture(None, AT_ORIGIN, None).electrons
    return michelson(electrons[118:138, 78:178].mean(axis=0))


@pytest.mark.parametrize(("z", "tilt_x"), [(0.06, 0.0), (0.1, 0.0), (0.14, 0.0), (0.09, 0.5), (0.09, -0.5)])
def test_stripe_edges_lie_where_triangulation_says(camera, flat_camera, rig, make_plane, z, tilt_x):
    images = []
    for scope in (camera, flat_camera):
        scope.set_optics(WITHOUT_STRAY_LIGHT)
        scope.attach_geometry(make_plane(z, tilt_x=tilt_x, half=0.2))
        images.append(scope.capture(None, AT_ORIGIN, None).electrons[128].astype(float))
    mask = rig.mask
    edges = -mask.half_width_tan + 0.5 * mask.period_tan * np.arange(1, 2 * mask.stripes)
    # On this plane 1/Z = (1 - x_c tan(tilt)) / z: x_p = x_c - b/Z is linear in x_c.
    slope = 1.0 + rig.baseline_m * np.tan(tilt_x) / z
    expected = (edges + rig.baseline_m / z) / slope * rig.camera.fx + rig.camera.cx
    with np.errstate(invalid="ignore", divide="ignore"):
        transmission = images[0] / images[1]
    difference = transmission - 0.5
    crossings = np.flatnonzero(difference[:-1] * difference[1:] < 0.0)
    found = crossings + 0.5 + difference[crossings] / (difference[crossings] - difference[crossings + 1])
    # Next to its border the pattern is not periodic, and the flat field ends; there edges shift with the blur.
    sure = expected[2:-4][(expected[2:-4] > 2.0) & (expected[2:-4] < 254.0)]
    assert len(sure) > 25
    for edge in sure:
        assert np.abs(found - edge).min() < 0.1  # px, as promised


def test_contrast_is_that_of_the_real_scope_and_falls_with_distance(camera, make_plane):
    contrast = [plane_contrast(camera, make_plane(z)) for z in (0.06, 0.07, 0.085, 0.1, 0.12, 0.14)]
    assert contrast[1] == pytest.approx(0.58, abs=0.03)
    assert contrast[3] == pytest.approx(0.44, abs=0.03)
    assert (np.diff(contrast) < 0.0).all()
    assert contrast[-1] > 0.25  # still stripes


def test_scattering_under_the_surface_lowers_contrast(camera, make_plane):
    matte = plane_contrast(camera, make_plane(0.08))
    tissue = plane_contrast(camera, make_plane(0.08, object_id=ObjectId.TISSUE))
    assert 0.6 * matte < tissue < 0.95 * matte


def brightest_stripe(camera, plane):
    """Brightest of the stripes around the centre, as a fraction of full scale."""
    camera.attach_geometry(plane)
    profile = camera.capture(None, AT_ORIGIN, None).electrons[118:138, 78:178].mean(axis=0)
    return profile.max() / camera.optics.full_well_electrons


def test_exposure_suits_the_working_distances(camera, make_plane):
    far, usual, near = (make_plane(z, object_id=ObjectId.TISSUE) for z in (0.14, 0.085, 0.06))
    assert brightest_stripe(camera, far) > 0.1
    assert 0.4 < brightest_stripe(camera, usual) < 0.6
    camera.set_optics(replace(camera.optics, tissue=replace(camera.optics.tissue, reflectance=0.0)))
    assert brightest_stripe(camera, near) < 1.0


def test_moving_the_camera_along_a_plane_does_not_change_the_image(camera, make_plane):
    camera.attach_geometry(make_plane(0.09))
    images = []
    for shift in (0.0, 0.0031, -0.0123):
        pose = np.eye(4)
        pose[:2, 3] = shift, 2.0 * shift
        images.append(camera.capture(None, pose, None).electrons)
    # Rounding in float32, over stripes with a slope of a tenth a pixel.
    np.testing.assert_allclose(images[1], images[0], rtol=1e-3)
    np.testing.assert_allclose(images[2], images[0], rtol=1e-3)


def test_electrons_follow_distance_angle_and_albedo_in_closed_form(flat_camera, rig, make_plane):
    optics = replace(WITHOUT_STRAY_LIGHT, led_exponent=2.0, vignetting_exponent=3.0)
    flat_camera.set_optics(optics)
    rays = rig.camera.rays
    for z, tilt in ((0.06, 0.0), (0.12, 0.0), (0.1, 0.5)):
        flat_camera.attach_geometry(make_plane(z, tilt_x=tilt, half=0.3))
        electrons = flat_camera.capture(None, AT_ORIGIN, None).electrons
        depth = z / (1.0 - rays[..., 0] * np.tan(tilt))
        to_projector = np.array([rig.baseline_m, 0.0, 0.0]) - rays * depth[..., None]
        distance = np.linalg.norm(to_projector, axis=-1)
        normal = np.array([np.tan(tilt), 0.0, -1.0]) * np.cos(tilt)
        irradiance = optics.axial_intensity_w_sr(flat_camera.rig.mask) * (depth / distance) ** 2 / distance**2
        radiance = irradiance * (to_projector @ normal) / distance * optics.other.albedo / np.pi
        expected = radiance * optics.electrons_per_radiance * np.linalg.norm(rays, axis=-1) ** -3.0
        middle = np.s_[60:196, 60:196]  # away from the blurred borders of the mask
        np.testing.assert_allclose(electrons[middle], expected[middle], rtol=1e-4)


def test_specular_reflection_peaks_between_camera_and_projector(camera, make_plane):
    camera.attach_geometry(make_plane(0.08, object_id=ObjectId.TISSUE))
    electrons = camera.capture(None, AT_ORIGIN, None).electrons.astype(float)
    dull = replace(camera.optics, tissue=replace(camera.optics.tissue, reflectance=0.0))
    camera.set_optics(dull)
    gloss = electrons - camera.capture(None, AT_ORIGIN, None).electrons
    columns = gloss.sum(axis=0)
    centre = (columns * (np.arange(256) + 0.5)).sum() / columns.sum()
    # Half the baseline at 80 mm is 6.9 px; the stripes under the highlight pull its centre by a pixel or two.
    assert centre == pytest.approx(128.0 + 6.9, abs=3.0)
    assert (gloss >= -1e-3).all()


def test_shadow_gets_only_what_the_cavity_reflects(camera, rig, plate_before_wall):
    camera.attach_geometry(plate_before_wall())
    optics = StripeOptics(lens_blur_px=0.0, vignetting_exponent=0.0)
    camera.set_optics(optics)
    capture = camera.capture(None, AT_ORIGIN, None)
    # The aperture's edge, 1.65 mm off, lights what the plate hides from its centre up to two thirds of that farther in.
    across = np.abs(capture.projector_x + rig.baseline_m / 0.06)
    inside = 0.1 * np.maximum(across, np.abs(capture.projector_y)) < 0.008 / 0.6 - 0.00165 * 2.0 / 3.0
    umbra = inside & (capture.depth_mm > 99.0)
    assert umbra.sum() > 200
    lit = capture.lit & (capture.depth_mm > 99.0)
    assert np.ptp(capture.electrons[umbra]) < 1e-3 * capture.electrons[umbra].mean()  # the same everywhere
    assert 0.01 < capture.electrons[umbra].mean() / capture.electrons[lit].mean() < 0.1
    camera.set_optics(replace(optics, cavity_fraction=0.0))
    assert (camera.capture(None, AT_ORIGIN, None).electrons[umbra] == 0.0).all()


def test_other_lights_add_the_same_irradiance_everywhere(camera, rig, plate_before_wall):
    camera.attach_geometry(plate_before_wall())
    dark = StripeOptics(lens_blur_px=0.0, vignetting_exponent=0.0)
    without, with_lamp = (_expected(camera, replace(dark, ambient_w_m2=irradiance)) for irradiance in (0.0, 2.0))
    seen = np.isfinite(camera.capture(None, AT_ORIGIN, None).depth_mm)
    expected = dark.electrons_per_radiance * dark.other.albedo * 2.0 / np.pi
    # Shadows and slopes are lit as everything else is.
    np.testing.assert_allclose((with_lamp - without)[seen], expected, rtol=1e-3)


def _expected(camera, optics):
    camera.set_optics(optics)
    return camera.capture(None, AT_ORIGIN, None).electrons.astype(float)


def test_noise_follows_the_photon_transfer_curve(flat_camera, make_plane):
    optics = replace(WITHOUT_STRAY_LIGHT, read_noise_electrons=20.0, led_power_w=0.02)
    flat_camera.set_optics(optics)
    flat_camera.attach_geometry(make_plane(0.08))
    rng = np.random.default_rng(11)
    captures = [flat_camera.capture(None, AT_ORIGIN, rng) for _ in range(60)]
    images = np.stack([c.image for c in captures]).astype(float)
    mean = captures[0].electrons.astype(float)
    electrons_per_level = optics.full_well_electrons / 255.0
    variance = images.var(axis=0, ddof=1) * electrons_per_level**2
    expected = mean + 20.0**2 + electrons_per_level**2 / 12.0
    for low, high in ((300.0, 1000.0), (1000.0, 2000.0), (2000.0, 4000.0), (4000.0, 8000.0)):
        band = (mean > low) & (mean < high)
        assert band.sum() > 400
        # 60 images of over 400 pixels leave a statistical error below 1 %.
        assert variance[band].mean() == pytest.approx(expected[band].mean(), rel=0.03)
        assert images[:, band].mean() * electrons_per_level == pytest.approx(mean[band].mean(), rel=0.005)


def test_same_seed_gives_the_same_bits(camera, make_plane):
    camera.attach_geometry(make_plane(0.08, tilt_y=0.3))
    first, again, other = (camera.capture(None, AT_ORIGIN, np.random.default_rng(seed)).image for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).mean() > 0.1


def test_image_without_noise_is_the_rounded_expectation(camera, make_plane):
    camera.attach_geometry(make_plane(0.08))
    capture = camera.capture(None, AT_ORIGIN, None)
    levels = capture.electrons.astype(float) / camera.optics.full_well_electrons * 255.0
    assert np.abs(np.clip(levels, 0.0, 255.0) - capture.image).max() < 0.501


def test_too_much_light_saturates(camera, make_plane):
    camera.set_optics(StripeOptics(led_power_w=1.0))
    camera.attach_geometry(make_plane(0.06))
    capture = camera.capture(None, AT_ORIGIN, np.random.default_rng(0))
    assert (capture.image[100:156, 100:156] == 255).all()


def test_a_projector_without_light_leaves_read_noise(camera, make_plane):
    camera.set_optics(StripeOptics(led_power_w=0.0))
    camera.attach_geometry(make_plane(0.06))
    assert camera.capture(None, AT_ORIGIN, np.random.default_rng(0)).image.max() == 0


@pytest.mark.parametrize("sigma", [0.3, 0.7, 2.0])
def test_edges_of_objects_get_the_lens_point_spread(clear_camera, make_plane, sigma):
    clear_camera.attach_geometry(step_scene(make_plane))
    rows = []
    for width in (0.0, sigma):
        # Without the cosines to the fourth the step is flat enough to be taken for one.
        clear_camera.set_optics(replace(WITHOUT_STRAY_LIGHT, lens_blur_px=width, vignetting_exponent=1.0))
        rows.append(clear_camera.capture(None, AT_ORIGIN, None).electrons[128, 112:144].astype(float))
    sharp, soft = rows
    at = np.arange(32) - 15.5
    height = sharp[15]
    assert sharp[16] == 0.0
    # A step of that height from light to dark and its blurred self differ by a first moment of half the variance.
    assert np.sum(at * (soft - sharp)) / (0.5 * height) == pytest.approx(sigma**2, rel=0.03)
    assert soft[15] + soft[16] == pytest.approx(height, rel=0.01)


def test_no_electron_is_lost_to_the_point_spread(clear_camera, make_plane):
    clear_camera.attach_geometry(make_plane(0.08, tilt_x=0.4))
    images = []
    for width in (0.0, 3.0):
        clear_camera.set_optics(replace(WITHOUT_STRAY_LIGHT, lens_blur_px=width))
        images.append(clear_camera.capture(None, AT_ORIGIN, None).electrons)
    assert np.abs(images[1] - images[0]).max() > 0.02 * images[0].max()
    # Sums of float32 over 65536 pixels.
    assert images[1].sum(dtype=float) == pytest.approx(images[0].sum(dtype=float), rel=1e-5)


def test_stripes_lose_what_the_lens_takes(camera, make_plane):
    camera.attach_geometry(make_plane(0.085))
    contrast = []
    for width in (0.0, 1.5):
        camera.set_optics(replace(StripeOptics(), lens_blur_px=width))
        row = camera.capture(None, AT_ORIGIN, None).electrons[100:156, 78:178].mean(axis=0).astype(float)
        wave = np.exp(-2j * np.pi * np.arange(100) / (0.05773503 * camera.rig.camera.fx))
        contrast.append(np.abs(np.sum(row * wave)) / row.sum())
    period_px = 0.05773503 * camera.rig.camera.fx
    assert contrast[1] / contrast[0] == pytest.approx(np.exp(-2.0 * (np.pi * 1.5 / period_px) ** 2), rel=0.01)


def test_noise_comes_after_the_lens(clear_camera, make_plane):
    clear_camera.attach_geometry(make_plane(0.08))
    clear_camera.set_optics(replace(WITHOUT_STRAY_LIGHT, lens_blur_px=1.5))
    rng = np.random.default_rng(4)
    captures = [clear_camera.capture(None, AT_ORIGIN, rng) for _ in range(24)]
    noise = (np.stack([c.image for c in captures]) - captures[0].electrons * (255.0 / 10500.0))[:, 60:196, 60:196]
    neighbours = np.mean(noise[:, :, 1:] * noise[:, :, :-1]) / np.mean(noise**2)
    assert abs(neighbours) < 0.01  # 444000 samples: standard error 0.0015; blurred noise would have 0.9


def test_twelve_bits_resolve_sixteen_times_more_and_follow_the_photon_transfer_curve(clear_camera, make_plane):
    clear_camera.attach_geometry(make_plane(0.09))
    rng = np.random.default_rng(3)
    electrons_per_level = WITHOUT_STRAY_LIGHT.full_well_electrons / 4095.0
    for light in (0.02, 0.2, 0.8):
        optics = replace(WITHOUT_STRAY_LIGHT, bits=12, led_power_w=light * WITHOUT_STRAY_LIGHT.led_power_w)
        clear_camera.set_optics(optics)
        captures = [clear_camera.capture(None, AT_ORIGIN, rng) for _ in range(6)]
        assert captures[0].image.dtype == np.uint16
        mean = captures[0].electrons.astype(float)
        band = (mean > 0.5 * mean.max()) & (mean < 9000.0)
        assert band.sum() > 10000
        images = np.stack([capture.image for capture in captures])[:, band] * electrons_per_level
        variance = np.mean((images - mean[band]) ** 2)
        expected = mean[band].mean() + optics.read_noise_electrons**2 + electrons_per_level**2 / 12.0
        # 60000 samples or more leave a statistical error of 0.6 %.
        assert variance == pytest.approx(expected, rel=0.03)
        assert images.mean() == pytest.approx(mean[band].mean(), rel=0.003)


def test_twelve_bits_saturate_at_their_full_scale(clear_camera, make_plane):
    clear_camera.attach_geometry(make_plane(0.06))
    clear_camera.set_optics(replace(WITHOUT_STRAY_LIGHT, bits=12, led_power_w=1.0))
    assert clear_camera.capture(None, AT_ORIGIN, np.random.default_rng(0)).image.max() == 4095


def test_twelve_bits_round_to_the_eight_that_estimators_take(camera, make_plane, rig):
    camera.attach_geometry(make_plane(0.08))
    eight = camera.capture(None, AT_ORIGIN, None).image
    camera.set_optics(replace(StripeOptics(), bits=12))
    twelve = camera.capture(None, AT_ORIGIN, None).image
    camera.set_optics(StripeOptics())
    with pytest.raises(InvalidValueError, match="uint8"):
        check_image(twelve, rig)
    rounded = to_eight_bits(twelve)
    check_image(rounded, rig)
    # Rounding twice differs from rounding once where the first falls next to a half.
    assert np.abs(rounded.astype(int) - eight).max() <= 1
    assert (rounded != eight).mean() < 0.04
    assert to_eight_bits(np.array([[0, 8, 9, 4095]], dtype=np.uint16)).tolist() == [[0, 0, 1, 255]]


@pytest.mark.parametrize(
    ("reason", "image", "bits"),
    [
        ("uint16", np.zeros((2, 2), dtype=np.uint8), 12),
        ("bits", np.zeros((2, 2), dtype=np.uint16), 8),
        ("4095", np.full((2, 2), 5000, dtype=np.uint16), 12),
    ],
)
def test_only_twelve_bit_images_are_converted(reason, image, bits):
    with pytest.raises(InvalidValueError, match=reason):
        to_eight_bits(image, bits)


def test_nominal_image_has_not_changed(camera, make_plane):
    camera.attach_geometry(make_plane(0.085, tilt_x=0.3, object_id=ObjectId.TISSUE))
    row = camera.capture(None, AT_ORIGIN, np.random.default_rng(12)).image[100, 96:128]
    assert row.tolist() == NOMINAL_ROW
