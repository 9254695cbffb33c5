from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy.special import erf

from laploop.assets.stripe_mask import StripeMask
from laploop.envs.sensors.optics.mask_table import MaskTable
from laploop.envs.sensors.optics.projection_blur import ProjectionBlur
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.errors import InvalidValueError

HALF_WIDTH = StripeMask().half_width_tan


def grid_of(table):
    return table.start + table.step * np.arange(table.columns)


def blurred(table, sigma=0.0):
    """The mask in focus, blurred by a Gaussian."""
    return table.blurred(ProjectionBlur(sigma_tan=sigma, aperture_m=0.0033, focus_m=0.05))[0]


def draw_stripes(width=1600, stripes=20, height=32):
    """Grey values of the built-in mask as an image."""
    column = (np.arange(width) + 0.5) / width * stripes % 1.0
    return np.tile(np.where(column < 0.5, 255, 0).astype(np.uint8), (height, 1))


def save(tmp_path, pixels, **options):
    path = tmp_path / "mask.png"
    Image.fromarray(pixels).save(path, **options)
    return path


def test_the_built_in_mask_drawn_as_an_image_gives_the_same_table(tmp_path):
    drawn = MaskTable.from_mask(StripeMask.from_png(save(tmp_path, draw_stripes()), stripes=20))
    analytic = MaskTable.from_mask(StripeMask())
    assert (drawn.start, drawn.step, drawn.mean) == pytest.approx((analytic.start, analytic.step, analytic.mean))
    for sigma in (0.0, 0.005, 0.02):
        np.testing.assert_allclose(blurred(drawn, sigma), blurred(analytic, sigma), atol=2e-3)


def test_an_edge_out_of_focus_is_blurred_by_disk_and_gaussian():
    sigma = 0.009
    mask = StripeMask(stripes=1, duty=0.5)  # one edge in the middle: bright on the left
    table = MaskTable.from_mask(mask)
    blur = ProjectionBlur(sigma_tan=sigma, aperture_m=0.0033, focus_m=0.05)
    levels = table.blurred(blur)
    x = np.linspace(-0.1, 0.1, 401)
    for level in (5, 12, 32):
        radius = np.linspace(0.0, blur.largest_radius_tan, len(levels))[level]
        # The mean over the disk, strip by strip, of the edge that the Gaussian blurs.
        strips = radius * (np.arange(2000) + 0.5) / 1000.0 - radius
        weights = np.sqrt(radius**2 - strips**2)
        edge = 0.5 * (1.0 - erf((x[:, None] - strips) / (np.sqrt(2.0) * sigma)))
        expected = edge @ weights / weights.sum()
        np.testing.assert_allclose(np.interp(x, grid_of(table), levels[level]), expected, atol=2e-4)


def test_grey_is_transmission_from_the_left_border_to_the_right(tmp_path):
    ramp = np.tile(np.linspace(0, 255, 256).round().astype(np.uint8), (4, 1))
    table = MaskTable.from_mask(StripeMask.from_png(save(tmp_path, ramp), stripes=20))
    inside = np.abs(grid_of(table)) < 0.95 * HALF_WIDTH
    expected = 0.5 + 0.5 * grid_of(table)[inside] / HALF_WIDTH
    np.testing.assert_allclose(blurred(table)[inside], expected, atol=0.005)  # a step of the ramp is 0.004
    np.testing.assert_allclose(blurred(table)[np.abs(grid_of(table)) > 1.01 * HALF_WIDTH], 0.0, atol=1e-6)
    assert table.mean == pytest.approx(0.5, abs=1e-3)


def test_a_profile_of_one_step_is_a_clear_mask():
    clear = MaskTable.from_mask(StripeMask(profile=(1.0,)))
    np.testing.assert_allclose(blurred(clear, 0.01)[np.abs(grid_of(clear)) < 0.4], 1.0, atol=1e-6)


def test_the_mean_of_wandering_edges_is_what_roughness_gives():
    rough = StripeMask(edge_roughness=0.05)
    table = MaskTable.from_mask(rough)
    shifts = np.random.default_rng(3).normal(0.0, 0.05 * rough.period_tan, 20000)
    # Around the right edge of the bright stripe next to the middle.
    edge = 0.5 * rough.period_tan
    x = grid_of(table)
    near = np.abs(x - edge) < 0.2 * rough.period_tan
    lit = (x[near][:, None] < edge + shifts).mean(axis=1)
    # 20000 draws leave a standard error of 0.0035 at most; 4 of them.
    np.testing.assert_allclose(blurred(table)[near], lit, atol=0.014)


def test_roughness_takes_contrast_as_a_gaussian_blur_of_the_edges_does():
    smooth, rough = StripeMask(), StripeMask(edge_roughness=0.06)
    tables = [MaskTable.from_mask(mask) for mask in (smooth, rough)]
    x = np.linspace(-4.0, 4.0, 4000, endpoint=False) * smooth.period_tan
    wave = np.exp(-2j * np.pi * x / smooth.period_tan)
    for sigma in (0.0, 0.009, 0.018):
        plain, lost = (np.abs(np.mean(np.interp(x, grid_of(t), blurred(t, sigma)) * wave)) for t in tables)
        assert lost / plain == pytest.approx(np.exp(-2.0 * (np.pi * 0.06) ** 2), rel=2e-3)


def test_a_coarser_table_makes_all_but_the_same_image(rig, make_plane):
    images = []
    for columns in (4097, 1025):
        camera = StripeCamera(rig, mask_columns=columns)
        camera.attach_geometry(make_plane(0.06))
        images.append(camera.capture(None, np.eye(4), None).electrons)
    # A third of a pixel a column; the sharpest blur in use is two pixels wide.
    np.testing.assert_allclose(images[1], images[0], atol=2e-3 * images[0].max())
    for columns in (16, 20000):
        with pytest.raises(InvalidValueError, match="columns"):
            MaskTable.from_mask(StripeMask(), columns)


def test_a_camera_projects_the_mask_from_an_image(tmp_path, rig, make_plane):
    drawn = StripeMask.from_png(save(tmp_path, draw_stripes()), stripes=20)
    images = []
    for mask in (rig.mask, drawn):
        camera = StripeCamera(replace(rig, mask=mask))
        camera.attach_geometry(make_plane(0.08))
        images.append(camera.capture(None, np.eye(4), None).electrons)
    np.testing.assert_allclose(images[1], images[0], atol=2e-3 * images[0].max())
