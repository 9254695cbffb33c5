import numpy as np
import pytest

from laploop.assets.mask_pattern import decode_pattern, encode_pattern
from laploop.assets.stripe_mask import StripeMask
from laploop.errors import InvalidValueError


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
def test_only_transmissions_can_be_encoded(values):
    with pytest.raises(InvalidValueError, match="pattern"):
        encode_pattern(values)
