"""What is made of a depth map that has arrived, and how good it is said to be."""

from types import SimpleNamespace

import numpy as np
import pytest

from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.tasks.observations import MAX_DEPTH_MM, depth_observation, depth_quality
from laploop.perception.messages import DepthEstimate, DepthFrame

TRUTH_MM = np.array([[100.0, 90.0, 80.0], [70.0, 60.0, np.nan]], np.float32)
ESTIMATE_MM = np.array([[102.0, 89.0, 300.0], [70.0, 65.0, 50.0]], np.float32)
VALID = np.array([[True, True, True], [True, False, True]])
TISSUE, TOOL, NOTHING = ObjectId.TISSUE, ObjectId.TOOL, ObjectId.BACKGROUND
SEEN = np.array([[TISSUE, TISSUE, TOOL], [TISSUE, TISSUE, NOTHING]], np.uint8)


@pytest.fixture
def served():
    depth = DepthFrame(
        index=0,
        estimate=DepthEstimate(depth_mm=ESTIMATE_MM.copy(), valid=VALID.copy()),
        captured_ns=40_000_000,
        available_ns=80_000_000,
        world_from_camera=np.eye(4),
    )
    truth = SimpleNamespace(depth_mm=TRUTH_MM, object_id=SEEN)
    return SimpleNamespace(depth=depth, captured=SimpleNamespace(depth=truth))


def test_depth_is_zero_where_it_is_not_valid_and_bounded_elsewhere(served):
    observation = depth_observation(served, 100_000_000)
    np.testing.assert_array_equal(observation["depth_mm"], [[102.0, 89.0, MAX_DEPTH_MM], [70.0, 0.0, 50.0]])
    np.testing.assert_array_equal(observation["depth_valid"], [[1, 1, 1], [1, 0, 1]])
    assert (observation["depth_mm"].dtype, observation["depth_valid"].dtype) == (np.float32, np.uint8)
    # Since its capture, not since its arrival.
    assert observation["depth_age_s"] == pytest.approx([0.06])


def test_quality_is_that_of_the_tissue_alone(served):
    mae_mm, share = depth_quality(served)
    # Of four pixels of tissue three are valid, off by 2, 1 and 0 mm.
    assert mae_mm == pytest.approx(1.0)
    assert share == 0.75


def test_without_a_valid_pixel_there_is_no_error_to_tell(served):
    served.depth.estimate.valid[:] = False
    mae_mm, share = depth_quality(served)
    assert np.isnan(mae_mm)
    assert share == 0.0
