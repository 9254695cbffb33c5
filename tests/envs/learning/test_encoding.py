import numpy as np
import pytest
from gymnasium import spaces

from laploop.envs.learning.encoding import (
    BOUND,
    DEPTH_FAR_MM,
    DEPTH_NEAR_MM,
    VectorLayout,
    decode_depth,
    encode_depth,
    encode_stripes,
)

LAYOUT = VectorLayout.of(
    {"tip_position": 3, "frame_age": 1}, {"target_pixel": spaces.Box(0.0, 256.0, (2,)), "path": spaces.Box(0.0, 1.0, (2, 2))}
)
QUANTITIES = {
    "tip_position": [0.05, -0.025, 0.115],
    "frame_age": [0.04],
    "target_pixel": [128.0, 64.0],
    "path": [0.0, 0.5, 1.0, 0.25],
}


def test_a_vector_holds_its_entries_in_order_each_scaled():
    vector = LAYOUT.encode(QUANTITIES)
    assert vector.dtype == np.float32
    np.testing.assert_allclose(vector, [1.0, -0.5, 0.5, 0.4, 0.0, -0.5, -1.0, 0.0, 1.0, -0.5], atol=1e-6)
    assert LAYOUT.slices["target_pixel"] == slice(4, 6)
    assert LAYOUT.space().contains(vector)


def test_many_environments_are_encoded_at_once_as_one_is():
    many = {name: np.array([values, np.multiply(values, 0.5)]) for name, values in QUANTITIES.items()}
    vectors = LAYOUT.encode(many)
    assert vectors.shape == (2, LAYOUT.size)
    np.testing.assert_array_equal(vectors[0], LAYOUT.encode(QUANTITIES))
    depth_mm = np.random.default_rng(0).uniform(30.0, 180.0, (3, 4, 5)).astype(np.float32)
    images = encode_depth(depth_mm, depth_mm > 40.0)
    assert images.shape == (3, 4, 5, 1)
    np.testing.assert_array_equal(images[1], encode_depth(depth_mm[1], depth_mm[1] > 40.0))


def test_decoding_gives_the_quantities_back():
    decoded = LAYOUT.decode(LAYOUT.encode(QUANTITIES))
    for name, values in QUANTITIES.items():
        np.testing.assert_allclose(decoded[name], values, atol=1e-5)


def test_what_is_far_away_is_clipped():
    vector = LAYOUT.encode({**QUANTITIES, "tip_position": [9.0, -9.0, 0.0], "frame_age": [100.0]})
    np.testing.assert_array_equal(vector[[0, 1, 3]], [BOUND, -BOUND, BOUND])


def test_the_grey_values_of_depth():
    depth_mm = np.array([[10.0, DEPTH_NEAR_MM, 100.0], [DEPTH_FAR_MM, 300.0, 100.0]], dtype=np.float32)
    valid = np.array([[True, True, True], [True, True, False]])
    image = encode_depth(depth_mm, valid)
    assert image.dtype == np.uint8
    # 100 mm is the middle of 40 to 160 mm: 1 + 127.
    assert image[..., 0].tolist() == [[1, 1, 128], [255, 255, 0]]
    back = decode_depth(image)
    assert np.isnan(back[1, 2])
    # Half a level: 120 mm over 254, halved.
    assert back[0, 2] == pytest.approx(100.0, abs=0.24)


def test_an_image_of_stripes_is_a_copy():
    image = np.arange(6, dtype=np.uint8).reshape(2, 3)
    encoded = encode_stripes(image)
    assert encoded.shape == (2, 3, 1)
    encoded[:] = 0
    assert image[1, 2] == 5
