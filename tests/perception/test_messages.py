from dataclasses import replace

import numpy as np
import pytest

from laploop.errors import InvalidValueError
from laploop.perception.messages import DepthEstimate, DepthFrame, StripeFrame

TIMES = {"index": 3, "captured_ns": 1_000, "available_ns": 2_000, "world_from_camera": np.eye(4)}
ESTIMATE = DepthEstimate(depth_mm=np.full((4, 6), 80.0, np.float32), valid=np.ones((4, 6), bool))
FRAMES = {"stripes": StripeFrame(image=np.zeros((4, 6), np.uint8), **TIMES), "depth": DepthFrame(estimate=ESTIMATE, **TIMES)}


@pytest.mark.parametrize("frame", FRAMES.values(), ids=FRAMES)
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"index": 1.5}, "index is 1.5; allowed: an integer"),
        ({"captured_ns": True}, "captured_ns is True"),
        ({"available_ns": "late"}, "available_ns is 'late'"),
        ({"available_ns": 999}, "available_ns is 999; allowed: captured_ns, 1000, or later"),
        ({"world_from_camera": np.eye(3)}, r"shape of world_from_camera is \(3, 3\)"),
        ({"world_from_camera": np.diag([1.0, 1.0, -1.0, 1.0])}, "a rigid transform"),
        ({"world_from_camera": np.full((4, 4), np.nan)}, "a rigid transform"),
        ({"world_from_camera": [[1.0], [2.0, 3.0]]}, "a 4x4 matrix of numbers"),
    ],
)
def test_frames_with_impossible_times_or_poses_are_refused(frame, change, message):
    with pytest.raises(InvalidValueError, match=message):
        replace(frame, **change)


@pytest.mark.parametrize("image", [np.zeros((4, 6)), np.zeros((4, 6, 3), np.uint8), [[1, 2]], None])
def test_what_is_no_grey_image_is_refused(image):
    with pytest.raises(InvalidValueError, match=r"allowed: an array of uint8, \(height, width\)"):
        replace(FRAMES["stripes"], image=image)


def test_depth_frame_needs_an_estimate():
    with pytest.raises(InvalidValueError, match="estimate is 'float32, shape"):
        replace(FRAMES["depth"], estimate=ESTIMATE.depth_mm)
    assert FRAMES["depth"].age_ns(5_000) == 4_000


@pytest.mark.parametrize("name", ["confidence", "slip"])
def test_confidence_and_slip_are_optional_and_from_0_to_1(name):
    depth, valid = np.full((2, 3), 90.0, np.float32), np.ones((2, 3), bool)
    assert getattr(DepthEstimate(depth_mm=depth, valid=valid), name) is None
    good = np.linspace(0.0, 1.0, 6, dtype=np.float32).reshape(2, 3)
    assert getattr(DepthEstimate(depth_mm=depth, valid=valid, **{name: good}), name) is good
    for bad, message in (
        (good.astype(np.float64), "an array of float32"),
        (good[:1], r"shape \(2, 3\)"),
        (2.0 * good, "0 to 1 at every pixel"),
        (good - np.float32(0.1), f"{name} is -0.1"),
        (np.where(good > 0.5, np.float32(np.nan), good), f"{name} is nan"),
        (0.5, f"{name} is 'float'"),
    ):
        with pytest.raises(InvalidValueError, match=message):
            DepthEstimate(depth_mm=depth, valid=valid, **{name: bad})
