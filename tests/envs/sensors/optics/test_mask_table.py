from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from laploop.assets.stripe_mask import StripeMask
from laploop.envs.sensors.optics.mask_table import MaskTable
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.errors import InvalidValueError

HALF_WIDTH = StripeMask().half_width_tan


def grid_of(table):
    return table.start + table.step * np.arange(table.transmission.shape[1])


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
    assert (drawn.start, drawn.step, drawn.sigma_step) == (analytic.start, analytic.step, analytic.sigma_step)
    # From the first blur that occurs in practice on; below it the table's columns themselves blur an edge.
    np.testing.assert_allclose(drawn.transmission[4:], analytic.transmission[4:], atol=2e-3)
    assert np.abs(drawn.transmission[0] - analytic.transmission[0]).mean() < 5e-3


def test_grey_is_transmission_from_the_left_border_to_the_right(tmp_path):
    ramp = np.tile(np.linspace(0, 255, 256).round().astype(np.uint8), (4, 1))
    table = MaskTable.from_mask(StripeMask.from_png(save(tmp_path, ramp), stripes=20))
    inside = np.abs(grid_of(table)) < 0.95 * HALF_WIDTH
    expected = 0.5 + 0.5 * grid_of(table)[inside] / HALF_WIDTH
    np.testing.assert_allclose(table.transmission[0][inside], expected, atol=0.005)  # a step of the ramp is 0.004
    assert (table.transmission[0][np.abs(grid_of(table)) > 1.01 * HALF_WIDTH] == 0.0).all()


def test_a_profile_of_one_step_is_a_clear_mask():
    clear = MaskTable.from_mask(StripeMask(profile=(1.0,)))
    np.testing.assert_allclose(clear.transmission[8][np.abs(grid_of(clear)) < 0.4], 1.0, atol=1e-6)


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
    np.testing.assert_allclose(table.transmission[0][near], lit, atol=0.014)


def test_roughness_takes_contrast_as_a_gaussian_blur_of_the_edges_does():
    smooth, rough = StripeMask(), StripeMask(edge_roughness=0.06)
    tables = [MaskTable.from_mask(mask) for mask in (smooth, rough)]
    x = np.linspace(-4.0, 4.0, 4000, endpoint=False) * smooth.period_tan
    wave = np.exp(-2j * np.pi * x / smooth.period_tan)
    for level in (0, 6, 12):
        plain, lost = (np.abs(np.mean(np.interp(x, grid_of(t), t.transmission[level]) * wave)) for t in tables)
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
