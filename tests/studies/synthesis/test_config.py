import math
from dataclasses import replace

import numpy as np
import pytest

from laploop.errors import InvalidValueError
from laploop.studies.scenes.frame_conditions import CameraPose, FrameRanges, draw_tool
from laploop.studies.synthesis.config import TrainingFramesConfig


@pytest.mark.parametrize(
    "change",
    [
        {"frames_per_tissue": 0},
        {"tool_share": 1.5},
        {"seed": -1},
        {"seed": 1.5},
        {"workers": 0},
        {"train_tissues": -1},
        {"ill_exposed_share": math.nan},
        {"ranges": {"working_distance_m": (0.1, 0.1)}},
    ],
)
def test_impossible_configuration_is_refused(change):
    with pytest.raises(InvalidValueError, match=next(iter(change))):
        TrainingFramesConfig(**change)


def test_data_set_without_a_tissue_or_with_too_many_frames_is_refused():
    with pytest.raises(InvalidValueError, match="at least 1 over the three splits"):
        TrainingFramesConfig(train_tissues=0, val_tissues=0, test_tissues=0)
    with pytest.raises(InvalidValueError, match="number of frames is 1500000; allowed: at most 1000000"):
        TrainingFramesConfig(train_tissues=100, val_tissues=25, test_tissues=25, frames_per_tissue=10_000)


@pytest.mark.parametrize(
    "change",
    [
        {"working_distance_m": (0.1, 10.0)},
        {"usual_distance_m": (0.11, 0.07)},
        {"shift_m": 1.0},
        {"tilt_rad": 3.0},
        {"tool_tilt_rad": (0.5, 3.0)},
        {"tool_azimuth_rad": -0.1},
        {"tool_clearance_m": 0.05},
        {"hover_m": (0.0, 1.0)},
        {"press_m": (0.0, 1.0)},
        {"light": (0.0, 1.0)},
    ],
)
def test_frames_that_cannot_be_taken_are_refused_by_the_field(change):
    with pytest.raises(InvalidValueError, match=next(iter(change))):
        FrameRanges(**change)


def test_recipe_holds_all_that_decides_the_frames():
    plan = TrainingFramesConfig()
    assert plan.recipe == replace(plan, workers=1).recipe
    assert plan.recipe != replace(plan, ranges=FrameRanges(shift_m=0.01)).recipe
    assert "optics" not in plan.recipe


@pytest.mark.parametrize("bump_m", [0.0, 0.025])
def test_an_instrument_is_always_found_and_clear_of_the_scope_where_the_surface_lets_it(bump_m):
    """At the limits of the ranges, on a plane, and on a bump that reaches to within 5 mm of the camera."""
    grid = np.stack(np.meshgrid(np.linspace(-0.05, 0.05, 41), np.linspace(-0.05, 0.05, 41)), axis=-1).reshape(-1, 2)
    height = bump_m * np.exp(-((grid / 0.01) ** 2).sum(axis=1))
    surface = np.column_stack([grid, height])
    camera = np.diag([1.0, -1.0, -1.0, 1.0])
    camera[2, 3] = 0.03
    pose = CameraPose(working_distance_m=0.03, world_from_camera=camera)
    rng = np.random.default_rng(0)
    for tilt in (0.3, 0.8, 1.4):
        clearance = 0.6 * 0.03 * math.sin(tilt)
        ranges = FrameRanges(working_distance_m=(0.03, 0.1), tool_tilt_rad=(tilt, tilt), tool_clearance_m=clearance)
        for _ in range(20):
            tool = draw_tool(ranges, pose, surface, tip_radius_m=0.0025, rng=rng)
            to_camera = camera[:3, 3] - tool.tip
            distance = np.linalg.norm(to_camera + max(0.0, -tool.axis @ to_camera) * tool.axis)
            assert bump_m > 0.0 or distance >= clearance
