import json

import numpy as np
import pytest
from PIL import Image

from laploop.assets.mask_fabrication import ROUTES, fabricated
from laploop.assets.mask_pattern import decode_pattern, encode_pattern
from laploop.assets.stripe_mask import StripeMask
from laploop.configuration import from_plain, to_plain
from laploop.errors import InvalidValueError, UnknownNameError


def test_a_pattern_comes_back_with_eight_bits():
    transmission = np.random.default_rng(0).random((37, 61))
    again = decode_pattern(encode_pattern(transmission))
    assert again.shape == (37, 61)
    # Half a step of 1/255.
    assert np.abs(again - transmission).max() <= 0.5 / 255.0 + 1e-12


@pytest.mark.parametrize("text", ["", "4x4", "4x4:!!", "0x4:", "2000x2000:", "2x2:" + encode_pattern(np.zeros((3, 3)))[4:]])
def test_text_that_is_no_pattern_is_refused(text):
    with pytest.raises(InvalidValueError, match="pattern"):
        StripeMask(pattern=text)


@pytest.mark.parametrize("values", [np.full((2, 2), 1.2), np.full((2, 2), np.nan), np.zeros(4), np.zeros((2, 1025))])
def test_what_is_no_transmission_is_not_encoded(values):
    with pytest.raises(InvalidValueError, match="pattern"):
        encode_pattern(values)


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


def test_a_printed_mask_is_rougher_than_a_chrome_one():
    printed, chrome = (fabricated(StripeMask(duty=0.45), route, seed=3) for route in ("printed", "chrome"))
    assert printed.duty == chrome.duty == 0.45
    assert printed.edge_wander > chrome.edge_wander
    assert printed.edge_roughness > chrome.edge_roughness
    assert printed.edge_seed == 3
    assert set(ROUTES) == {"printed", "chrome"}
    with pytest.raises(UnknownNameError, match="chrome, printed"):
        fabricated(StripeMask(), "etched")
    with pytest.raises(InvalidValueError, match="edge_wander"):
        fabricated(StripeMask(profile=(0.0, 1.0)), "printed")
