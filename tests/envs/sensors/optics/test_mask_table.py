import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from laploop.assets.stripe_mask import StripeMask
from laploop.configuration import from_plain, to_plain
from laploop.envs.sensors.optics.mask_table import MaskTable
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.errors import InvalidValueError, MissingFileError

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


@pytest.mark.parametrize("mode", ["1", "L", "I;16", "RGB", "RGBA", "P"])
def test_every_way_to_store_grey_is_read_alike(tmp_path, mode):
    pixels = draw_stripes(width=80)
    image = Image.fromarray(pixels.astype(np.uint16) * 257) if mode == "I;16" else Image.fromarray(pixels).convert(mode)
    image.save(tmp_path / "mask.png")
    mask = StripeMask.from_png(tmp_path / "mask.png", stripes=20)
    np.testing.assert_allclose(mask.profile, pixels[0] / 255.0, atol=1e-9)


def test_an_image_that_is_no_mask_is_refused_with_the_reason(tmp_path):
    colours = np.zeros((8, 32, 3), dtype=np.uint8)
    colours[..., 0] = 200
    see_through = np.full((8, 32, 4), 255, dtype=np.uint8)
    see_through[..., 3] = 100
    cases = {
        "grey": colours,
        "opaque": see_through,
        "square": draw_stripes(height=64, width=80).T.copy(),
        "size": np.zeros((8, 8), dtype=np.uint8),
        "brightest transmission": np.full((32, 32), 5, dtype=np.uint8),
    }
    for reason, pixels in cases.items():
        with pytest.raises(InvalidValueError, match=reason):
            StripeMask.from_png(save(tmp_path, pixels), stripes=20)


def test_a_file_that_is_no_png_is_refused(tmp_path):
    path = tmp_path / "mask.png"
    path.write_bytes(b"not an image")
    with pytest.raises(InvalidValueError, match=r"mask\.png"):
        StripeMask.from_png(path, stripes=20)
    whole = save(tmp_path, draw_stripes()).read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InvalidValueError, match=r"mask\.png"):
        StripeMask.from_png(path, stripes=20)
    Image.fromarray(draw_stripes()).save(tmp_path / "photo.jpg")
    with pytest.raises(InvalidValueError, match=r"photo\.jpg"):
        StripeMask.from_png(tmp_path / "photo.jpg", stripes=20)
    with pytest.raises(MissingFileError, match="nothing"):
        StripeMask.from_png(tmp_path / "nothing.png", stripes=20)
    with pytest.raises(MissingFileError, match="mask image"):
        StripeMask.from_png(tmp_path, stripes=20)


@pytest.mark.parametrize(
    ("field", "value"), [("edge_roughness", -0.1), ("edge_roughness", 0.3), ("profile", ()), ("profile", (0.5, 1.5))]
)
def test_impossible_masks_are_refused_by_name(field, value):
    with pytest.raises(InvalidValueError, match=field):
        StripeMask(**{field: value})


def test_a_mask_survives_json():
    mask = StripeMask(profile=(0.0, 0.25, 1.0), edge_roughness=0.02)
    again = from_plain(StripeMask, json.loads(json.dumps(to_plain(mask))))
    assert again == mask
    assert hash(again) == hash(mask)


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
