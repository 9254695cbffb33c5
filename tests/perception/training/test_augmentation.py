import numpy as np

from laploop.perception.training.augmentation import painted

GREY = {"image": np.full((96, 128), 100, np.uint8), "depth_mm": np.full((96, 128), 90.0, np.float32)}


def test_painting_changes_the_image_and_nothing_else():
    changed = painted(GREY, np.random.default_rng(0))
    assert changed["image"].dtype == np.uint8
    assert changed["image"].shape == (96, 128)
    assert changed["depth_mm"] is GREY["depth_mm"]
    assert (GREY["image"] == 100).all()


def test_patterns_have_sharp_rims_cover_a_part_and_differ():
    images = [painted(GREY, np.random.default_rng(seed))["image"] for seed in range(12)]
    assert len({image.tobytes() for image in images}) == len(images)
    untouched = [float((image == np.bincount(image.ravel()).argmax()).mean()) for image in images]
    assert 0.2 < np.mean(untouched) < 0.98
    steps = [int(np.abs(np.diff(image.astype(int), axis=1)).max()) for image in images]
    # Grey values between neighbours: a rim is about a pixel wide.
    assert np.median(steps) > 15


def test_same_generator_gives_the_same_pattern():
    first, second = (painted(GREY, np.random.default_rng(7))["image"] for _ in range(2))
    np.testing.assert_array_equal(first, second)
