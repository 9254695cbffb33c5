"""Distinct frames with their ages."""

import numpy as np
import pytest

from laploop.envs.loop.timing.config import TimingConfig
from laploop.envs.wrappers.age_aware_frame_stack import AgeAwareFrameStack
from laploop.errors import InvalidValueError

STILL = np.zeros(3, np.float32)


def test_a_frame_is_in_the_stack_once_and_ages_are_those_of_the_frames(task_env):
    env = AgeAwareFrameStack(task_env("reach", observation_mode="stripes", timing=TimingConfig(drop_rate=0.3)), 3)
    observation, _ = env.reset(seed=3)
    assert observation["stripes"].shape == (256, 256, 3)
    assert not observation["stripes"][..., :2].any()
    np.testing.assert_array_equal(observation["stripes_ages_s"][:2], [-1.0, -1.0])
    camera_s = env.unwrapped.config.loop.camera_ns * 1e-9
    for _ in range(40):
        observation, *_, info = env.step(STILL)
        assert env.observation_space.contains(observation)
    images, ages_s = np.moveaxis(observation["stripes"], 2, 0), observation["stripes_ages_s"]
    captured = {times.captured_ns for times in env.unwrapped.loop.timing_log.frames if times.arrived_ns is not None}
    assert {round(1e9 * (info["sim_s"] - float(age_s)), -6) for age_s in ages_s} <= {round(time, -6) for time in captured}
    gaps = -np.diff(ages_s)
    assert gaps.min() >= camera_s - 1e-6
    assert gaps.max() > 1.5 * camera_s
    assert all((images[one] != images[other]).any() for one, other in ((0, 1), (1, 2), (0, 2)))


def test_depth_and_its_validity_are_stacked_alike_and_other_entries_pass(task_env):
    env = AgeAwareFrameStack(task_env("reach", observation_mode="depth"), 2)
    env.reset(seed=3)
    for _ in range(8):
        observation, *_ = env.step(STILL)
    assert observation["depth_mm"].shape == observation["depth_valid"].shape == (256, 256, 2)
    np.testing.assert_array_equal(observation["depth_mm_ages_s"], observation["depth_valid_ages_s"])
    assert observation["depth_mm_ages_s"][1] == pytest.approx(float(observation["depth_age_s"][0]))
    assert observation["tip_position"].shape == (3,)


def test_images_with_a_channel_axis_are_stacked_along_it(decisions):
    env = AgeAwareFrameStack(decisions("reach", "depth"), 4)
    observation, _ = env.reset(seed=3)
    assert observation["depth"].shape == (256, 256, 4)
    assert observation["depth"].dtype == np.uint8


def test_vectors_and_bad_numbers_are_refused(task_env, decisions):
    with pytest.raises(InvalidValueError, match="observation space of AgeAwareFrameStack"):
        AgeAwareFrameStack(decisions())
    with pytest.raises(InvalidValueError, match="k is 0; allowed: an integer, 1 to 64"):
        AgeAwareFrameStack(task_env("reach"), 0)
