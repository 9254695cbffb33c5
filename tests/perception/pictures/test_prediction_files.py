import io

import cv2
import numpy as np
import pytest
import trimesh

from laploop.perception.geometry import Intrinsics
from laploop.perception.pictures.overlay import draw_overlay
from laploop.perception.pictures.prediction_files import depth_picture, prediction_files
from laploop.perception.pictures.predictor import PicturePrediction
from laploop.perception.stripe_check import StripePresence

K = Intrinsics(width=40, height=30, fx=35.0, fy=36.0, cx=19.0, cy=16.0)


def prediction(valid=None, *, confident=True):
    rng = np.random.default_rng(3)
    valid = rng.random((30, 40)) < 0.7 if valid is None else valid
    return PicturePrediction(
        image=rng.integers(0, 256, (30, 40), dtype=np.uint8),
        raw_depth_mm=rng.uniform(60.0, 140.0, (30, 40)).astype(np.float32),
        valid=valid,
        confidence=np.where(valid, rng.random((30, 40)), 0.0).astype(np.float32) if confident else None,
        slip=rng.random((30, 40)).astype(np.float32) if confident else None,
        stripes=StripePresence(striped=valid, drift_turns=0.0, spread_turns=0.0, present=True),
        estimate_ms=1.0,
    )


def read(content):
    return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)


def test_depth_and_probabilities_come_back_from_their_files():
    made = prediction()
    files = prediction_files("a", made, K)
    np.testing.assert_array_equal(np.load(io.BytesIO(files["a_raw.npy"])), made.raw_depth_mm)
    depth = np.load(io.BytesIO(files["a_depth.npy"]))
    np.testing.assert_array_equal(depth[made.valid], made.raw_depth_mm[made.valid])
    assert np.isnan(depth[~made.valid]).all()
    picture = read(files["a_depth.png"])
    assert picture.dtype == np.uint16
    assert (picture[~made.valid] == 0).all()
    assert np.abs(0.01 * picture - made.raw_depth_mm)[made.valid].max() < 0.00501  # mm, half a unit
    for what in ("confidence", "slip"):
        np.testing.assert_array_equal(np.load(io.BytesIO(files[f"a_{what}.npy"])), getattr(made, what))
        np.testing.assert_array_equal(read(files[f"a_{what}.png"]), np.round(255.0 * getattr(made, what)))
        assert not any(what in name for name in prediction_files("a", prediction(confident=False), K))


def test_depths_that_16_bits_do_not_hold_are_invalid():
    depth = np.array([[655.35, 655.36, 0.004, np.nan, -3.0, 100.006]], np.float32)
    np.testing.assert_array_equal(depth_picture(depth), [[65535, 0, 0, 0, 0, 10001]])


def test_cloud_holds_the_valid_pixels_in_millimetres_with_their_grey():
    made = prediction()
    content = prediction_files("a", made, K)["a_cloud.ply"]
    assert b"binary_little_endian" in content[:60]
    cloud = trimesh.load(io.BytesIO(content), file_type="ply")
    assert len(cloud.vertices) == made.valid.sum()
    pixels = K.project(np.asarray(cloud.vertices))
    rows, columns = np.nonzero(made.valid)
    np.testing.assert_allclose(pixels, np.stack([columns, rows], axis=-1) + 0.5, atol=1e-4)
    np.testing.assert_allclose(cloud.vertices[:, 2], made.raw_depth_mm[made.valid], rtol=1e-6)
    np.testing.assert_array_equal(cloud.colors[:, 0], made.image[made.valid])


def test_cloud_of_nothing_has_no_point():
    content = prediction_files("a", prediction(np.zeros((30, 40), bool)), K)["a_cloud.ply"]
    assert b"element vertex 0\n" in content
    assert content.endswith(b"end_header\n")


@pytest.mark.parametrize("valid", [True, False])
def test_overlay_colours_valid_pixels_alone_and_has_a_bar(valid):
    image = np.full((64, 96), 100, np.uint8)
    depth = np.full((64, 96), np.nan, np.float32)
    if valid:
        depth[:, 48:] = np.linspace(60.0, 140.0, 48)
    overlay = draw_overlay(image, depth)
    assert overlay.shape[0] == 512
    picture, bar = overlay[:, :768], overlay[:, 768:]
    assert (picture[:, :384] == 100).all()
    assert (np.ptp(picture[:, 384:].astype(int), axis=-1).max() > 50) == valid
    assert np.ptp(bar.astype(int), axis=-1).max() > 100
