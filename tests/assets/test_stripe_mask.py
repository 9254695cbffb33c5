import json

import numpy as np
import pytest
from PIL import Image

from laploop.assets.mask_pattern import decode_pattern, encode_pattern
from laploop.assets.stripe_mask import StripeMask
from laploop.configuration import from_plain, to_plain
from laploop.errors import InvalidValueError, MissingFileError


def draw_stripes(width=1600, stripes=20, height=32):
    """Grey values of the built-in mask as an image."""
    column = (np.arange(width) + 0.5) / width * stripes % 1.0
    return np.tile(np.where(column < 0.5, 255, 0).astype(np.uint8), (height, 1))


def save(tmp_path, pixels, **options):
    path = tmp_path / "mask.png"
    Image.fromarray(pixels).save(path, **options)
    return path


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


def test_a_mask_with_a_pattern_survives_json():
    mask = StripeMask(pattern=encode_pattern(np.eye(16)), stripes=4)
    again = from_plain(StripeMask, json.loads(json.dumps(to_plain(mask))))
    assert again == mask
    assert hash(again) == hash(mask)


def test_a_picture_becomes_a_pattern_and_upright_stripes_a_profile(tmp_path):
    rows = np.tile(np.where(np.arange(64) % 16 < 8, 255, 0).astype(np.uint8), (64, 1))
    for pixels, is_picture in ((rows, False), (rows.T.copy(), True)):
        Image.fromarray(pixels).save(tmp_path / "mask.png")
        mask = StripeMask.from_png(tmp_path / "mask.png", stripes=4)
        assert (mask.pattern is not None, mask.profile is not None) == (is_picture, not is_picture)
        assert mask.is_drawn
        assert mask.varies_along_y == is_picture
    assert mask.pattern is not None
    np.testing.assert_array_equal(decode_pattern(mask.pattern), rows.T / 255.0)


def test_a_large_picture_is_averaged(tmp_path):
    board = (np.indices((2048, 2048)).sum(axis=0) % 2 * 255).astype(np.uint8)
    Image.fromarray(board).save(tmp_path / "mask.png")
    pattern = StripeMask.from_png(tmp_path / "mask.png", stripes=20).pattern
    assert pattern is not None
    # Every new pixel covers two dark and two bright ones; half a step of 1/255 is lost to rounding.
    np.testing.assert_allclose(decode_pattern(pattern), np.full((1024, 1024), 0.5), atol=0.0021)


@pytest.mark.parametrize(
    ("field", "values"),
    [
        ("edge_wander", {"edge_wander": 0.2}),
        ("edge_wander", {"edge_wander": 0.05, "profile": (0.0, 1.0)}),
        ("edge_correlation", {"edge_correlation": 0.0}),
        ("edge_seed", {"edge_seed": -1}),
        ("profile", {"profile": (0.0, 1.0), "pattern": encode_pattern(np.ones((2, 2)))}),
    ],
)
def test_impossible_second_dimensions_are_refused_by_name(field, values):
    with pytest.raises(InvalidValueError, match=field):
        StripeMask(**values)
