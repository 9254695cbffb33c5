import numpy as np
import pytest

from laploop.assets.stripe_mask import StripeMask
from laploop.envs.sensors.optics.mask_table import MaskTable
from laploop.envs.sensors.optics.projection_blur import ProjectionBlur
from laploop.envs.sensors.optics.stripe_optics import Material, StripeOptics
from laploop.errors import InvalidValueError, LaploopError


@pytest.mark.parametrize(
    ("field", "value"),
    [("led_power_w", -1.0), ("exposure_s", 0.0), ("glare_fraction", 1.5), ("f_number", float("nan")), ("bits", 10)],
)
def test_optics_outside_their_range_are_refused_by_name(field, value):
    with pytest.raises(LaploopError, match=field):
        StripeOptics(**{field: value})


def test_materials_outside_their_range_are_refused_by_name():
    with pytest.raises(InvalidValueError, match="roughness"):
        Material(albedo=0.4, reflectance=0.02, roughness=0.0)


def test_electrons_follow_from_the_radiometry():
    optics = StripeOptics(f_number=2.0, lens_transmission=0.5, exposure_s=0.01, pixel_pitch_m=5e-6, quantum_efficiency=0.6)
    # Photon energy at 525 nm: 3.7837e-19 J.
    expected = np.pi * 0.5 / 16.0 * 25e-12 * 0.01 * 0.6 / 3.7837e-19
    assert optics.electrons_per_radiance == pytest.approx(expected, rel=1e-4)


def test_the_led_power_is_all_that_leaves_through_a_clear_mask():
    mask = StripeMask(fov_rad=np.radians(2.0))
    # A narrow field is a flat solid angle: power = intensity * (2 tan 1 deg)^2.
    intensity = StripeOptics(led_power_w=0.1).axial_intensity_w_sr(mask)
    assert intensity * (2.0 * np.tan(np.radians(1.0))) ** 2 == pytest.approx(0.1, rel=1e-3)


def look_up(table, x, sigma):
    grid = table.start + table.step * np.arange(table.columns)
    return np.interp(x, grid, table.blurred(ProjectionBlur(sigma_tan=sigma, aperture_m=0.003, focus_m=0.05))[0])


def test_sharp_mask_is_binary_and_starts_bright_at_the_left():
    mask = StripeMask(stripes=20)
    table = MaskTable.from_mask(mask)
    middles = -mask.half_width_tan + mask.period_tan * (np.arange(40) / 2.0 + 0.25)
    np.testing.assert_allclose(look_up(table, middles[::2], 0.0), 1.0, atol=1e-6)
    np.testing.assert_allclose(look_up(table, middles[1::2], 0.0), 0.0, atol=1e-6)
    np.testing.assert_allclose(look_up(table, np.array([-0.7, 0.7]), 0.0), 0.0, atol=1e-6)


def test_phase_shifts_the_stripes_and_duty_widens_them():
    half_a_period = MaskTable.from_mask(StripeMask(stripes=10, phase=0.5))
    mask = StripeMask(stripes=10)
    first_bright = -mask.half_width_tan + mask.period_tan * np.array([0.25, 0.75])
    np.testing.assert_allclose(look_up(half_a_period, first_bright, 0.0), [0.0, 1.0], atol=1e-6)
    grid = np.linspace(-mask.half_width_tan, mask.half_width_tan, 20001)
    for duty in (0.2, 0.5, 0.8):
        table = MaskTable.from_mask(StripeMask(stripes=10, duty=duty))
        assert look_up(table, grid, 0.0).mean() == pytest.approx(duty, abs=2e-3)


def test_blurred_mask_loses_the_fundamental_as_a_gaussian_should():
    mask = StripeMask(stripes=20)
    table = MaskTable.from_mask(mask)
    x = np.linspace(-0.5, 0.5, 20000, endpoint=False) * 8 * mask.period_tan
    for sigma in (0.006, 0.012, 0.024):
        wave = np.exp(-2j * np.pi * x / mask.period_tan)
        amplitude = 2.0 * np.abs(np.mean(look_up(table, x, sigma) * wave))
        expected = 2.0 / np.pi * np.exp(-2.0 * (np.pi * sigma / mask.period_tan) ** 2)
        assert amplitude == pytest.approx(expected, rel=1e-3)
