from dataclasses import replace

import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.stripe_capture import ExactView
from laploop.envs.tasks.target_choice import choose_target_pixel, qualifying_pixels
from laploop.envs.tasks.task_config import TargetChoiceConfig
from laploop.errors import SimulationError
from laploop.perception.geometry import Rig

CAMERA = Rig.from_optics(ScopeOptics()).camera
TROCAR = np.array([0.0, -0.05, -0.02])


@pytest.fixture
def wall():
    """A wall that faces the camera, nearer than the sensor measures in its left half."""
    shape = (CAMERA.height, CAMERA.width)
    depth_mm = np.full(shape, 80.0, np.float32)
    depth_mm[:, : CAMERA.width // 2] = 58.0
    normals = np.zeros((*shape, 3), np.float32)
    normals[..., 2] = -1.0
    ids = np.full(shape, ObjectId.TISSUE, np.uint8)
    middle = np.zeros(shape, np.float32)
    lit = np.ones(shape, bool)
    return ExactView(depth_mm=depth_mm, object_id=ids, normals=normals, projector_x=middle, projector_y=middle, lit=lit)


def test_a_target_lies_where_depth_can_be_measured(wall):
    fits = qualifying_pixels(wall, CAMERA, TROCAR, TargetChoiceConfig())
    assert fits.any()
    assert wall.depth_mm[fits].min() == 80.0
    near = qualifying_pixels(wall, CAMERA, TROCAR, TargetChoiceConfig(min_depth_m=0.05))
    assert wall.depth_mm[near].min() == 58.0


def test_the_error_says_at_what_depth_a_target_may_lie(wall):
    far = replace(wall, depth_mm=wall.depth_mm + 100.0)
    with pytest.raises(SimulationError, match="at a depth of 60 to 140 mm"):
        choose_target_pixel(far, CAMERA, TROCAR, np.random.default_rng(0), TargetChoiceConfig())
