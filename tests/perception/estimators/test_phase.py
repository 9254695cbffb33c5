import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.errors import InvalidValueError
from laploop.perception.estimators.phase import PhaseConfig, PhaseEstimator
from laploop.perception.geometry import Rig


def _plane(rig, depth_m, slope_x=0.0, slope_y=0.0):
    """Depth of the plane Z = depth + slope_x X + slope_y Y at each pixel."""
    rays = rig.camera.rays
    return depth_m / (1.0 - slope_x * rays[..., 0] - slope_y * rays[..., 1])


def _error(estimate, depth_m):
    return np.abs(estimate.depth_mm - 1e3 * depth_m)


@pytest.mark.parametrize("depth_m", [0.065, 0.085, 0.105, 0.135])
def test_facing_plane_is_found_to_a_third_of_a_millimetre(rig, render, depth_m):
    depth = np.full((256, 256), depth_m)
    estimate = PhaseEstimator(rig=rig).estimate(render(rig, depth))
    assert estimate.valid[:, 40:-10].mean() > 0.99
    # mm; harmonics of the stripes and 8-bit grey values bend the phase by some hundredths of a radian.
    assert np.mean(_error(estimate, depth)[estimate.valid]) < 0.35


@pytest.mark.parametrize(("slope_x", "slope_y"), [(0.3, 0.0), (-0.3, 0.0), (0.0, 0.5), (0.2, -0.2)])
def test_tilted_plane_is_found_to_half_a_millimetre(rig, render, slope_x, slope_y):
    depth = _plane(rig, 0.09, slope_x, slope_y)
    estimate = PhaseEstimator(rig=rig).estimate(render(rig, depth))
    seen = estimate.valid & (depth > 0.062) & (depth < 0.14)
    assert seen.mean() > 0.6
    assert np.mean(_error(estimate, depth)[seen]) < 0.5  # mm; the phase is nearly linear within the window


def test_ball_is_found_to_one_millimetre_away_from_its_outline(rig, render, sphere_depth):
    depth, on_ball = sphere_depth(rig)
    estimate = PhaseEstimator(rig=rig).estimate(render(rig, depth))
    x, y = np.meshgrid(np.arange(256), np.arange(256))
    inner = estimate.valid & on_ball & (np.hypot(x - 136, y - 115) < 55)
    assert inner.sum() > 6000
    assert np.mean(_error(estimate, depth)[inner]) < 1.0  # mm; curvature within the window


def test_shading_and_albedo_do_not_move_a_plane(rig, render):
    depth = np.full((256, 256), 0.09)
    x = np.linspace(-1.0, 1.0, 256)
    albedo = 0.7 + 0.25 * np.sin(5.0 * x)[None, :] * np.cos(4.0 * x)[:, None]
    estimate = PhaseEstimator(rig=rig).estimate(render(rig, depth, albedo=albedo))
    assert np.mean(_error(estimate, depth)[estimate.valid]) < 0.5  # mm


def test_shot_noise_costs_less_than_half_a_millimetre(rig, render):
    depth = np.full((256, 256), 0.1)
    image = render(rig, depth, rng=np.random.default_rng(3), bright=100.0)
    estimate = PhaseEstimator(rig=rig).estimate(image)
    assert np.mean(_error(estimate, depth)[estimate.valid]) < 0.5  # mm


@pytest.mark.parametrize("phase", [0.25, 0.6])
def test_shifted_mask_gives_the_same_depth(render, phase):
    rig = Rig.from_optics(ScopeOptics(mask=StripeMask(phase=phase)))
    depth = np.full((256, 256), 0.09)
    estimate = PhaseEstimator(rig=rig).estimate(render(rig, depth))
    assert np.mean(_error(estimate, depth)[estimate.valid]) < 0.5  # mm


@pytest.mark.parametrize("image", [np.zeros((256, 256), np.uint8), np.full((256, 256), 90, np.uint8)])
def test_nothing_is_valid_without_stripes(rig, image):
    estimate = PhaseEstimator(rig=rig).estimate(image)
    assert not estimate.valid.any()
    assert np.isfinite(estimate.depth_mm).all()


def test_saturated_pixels_are_invalid(rig, render):
    image = render(rig, np.full((256, 256), 0.08))
    image[100:140, 100:140] = 255
    assert not PhaseEstimator(rig=rig).estimate(image).valid[100:140, 100:140].any()


def test_pixels_beside_a_step_are_invalid(rig, render):
    depth = np.full((256, 256), 0.08)
    depth[128:] = 0.1
    estimate = PhaseEstimator(rig=rig).estimate(render(rig, depth))
    assert estimate.valid[127:129, 40:-10].mean() < 0.1
    assert estimate.valid[60:110, 40:-10].mean() > 0.95


def test_the_same_image_gives_the_same_bits(rig, render):
    image = render(rig, np.full((256, 256), 0.1), rng=np.random.default_rng(0))
    estimator = PhaseEstimator(rig=rig)
    first, second = estimator.estimate(image), estimator.estimate(image)
    np.testing.assert_array_equal(first.depth_mm, second.depth_mm)
    np.testing.assert_array_equal(first.valid, second.valid)


@pytest.mark.parametrize("image", [np.zeros((256, 200), np.uint8), np.zeros((256, 256), np.float32)])
def test_image_of_another_size_or_type_is_refused(rig, image):
    with pytest.raises(InvalidValueError, match="image"):
        PhaseEstimator(rig=rig).estimate(image)


@pytest.mark.parametrize(
    "change", [{"nearest_mm": 200.0}, {"window_periods": 0.0}, {"saturated": 300}, {"max_residual": float("nan")}]
)
def test_settings_out_of_range_are_refused(change):
    with pytest.raises(InvalidValueError):
        PhaseConfig(**change)


def test_depth_stays_finite_on_a_rig_whose_turn_ends_beyond_infinity(render):
    # A baseline over a period of 46 mm: at 60 mm the stripes are less than a turn of phase away from infinity.
    rig = Rig.from_optics(ScopeOptics(baseline_m=0.0026))
    depth = np.full((256, 256), 0.1)
    estimate = PhaseEstimator(rig=rig).estimate(render(rig, depth))
    assert estimate.depth_mm.max() <= 280.1
    assert not estimate.valid[estimate.depth_mm > 140.0].any()
