"""What all environments refuse, and what a user's own estimator or controller may not return."""

from dataclasses import replace

import numpy as np
import pytest

from laploop.envs.episode import run_episode
from laploop.envs.episode_config import EpisodeConfig
from laploop.envs.loop.kinematic_errors import KinematicErrors
from laploop.envs.tasks.configs import ReachConfig
from laploop.envs.tasks.reach import ReachEnv
from laploop.envs.tasks.registry import make_environment
from laploop.envs.tasks.track import TrackEnv
from laploop.errors import InvalidValueError, LaploopError, SimulationError, UnknownNameError
from laploop.perception.messages import DepthEstimate


def test_the_observed_force_lies_along_the_axes_that_the_robot_believes_in(task_env, monkeypatch):
    env = task_env("reach", kinematic_errors=KinematicErrors(hand_eye_rad=0.1))
    env.reset(seed=3)
    felt = replace(env.loop.reading(), contact_force_in_world=np.array([0.0, 0.0, 10.0]))
    monkeypatch.setattr(env.loop, "reading", lambda: felt)
    observation, *_ = env.step(np.zeros(3, np.float32))
    nominal, true = (
        pose[:3, :3].T @ felt.contact_force_in_world
        for pose in (env.loop.scope.world_from_camera(), env.loop.theatre.world_from_camera())
    )
    np.testing.assert_allclose(observation["contact_force"], nominal, atol=1e-5)  # float32 of 10 N
    np.testing.assert_allclose(observation["contact_force"], env.control_input().contact_force_in_camera, atol=1e-5)
    assert np.abs(nominal - true).max() > 0.3


@pytest.mark.parametrize(
    ("seed", "options", "kind", "message"),
    [
        (1.5, None, InvalidValueError, r"seed is 1\.5; allowed: an integer from 0"),
        (-1, None, InvalidValueError, "seed is -1"),
        (True, None, InvalidValueError, "seed is True"),
        ("1", None, InvalidValueError, "seed is '1'"),
        (
            0,
            {"target_pixels": (1, 2)},
            UnknownNameError,
            "unknown option of reset 'target_pixels'; did you mean 'target_pixel'",
        ),
        (0, "target_pixel", InvalidValueError, "options is 'target_pixel'; allowed: a mapping, or None"),
        (0, {"target_pixel": (300, 2)}, InvalidValueError, r"target_pixel is \(300, 2\); allowed: .* within 256 x 256 pixels"),
        (0, {"target_pixel": (float("nan"), 1)}, InvalidValueError, r"target_pixel is \(nan, 1\)"),
        (0, {"target_pixel": (-0.5, 1)}, InvalidValueError, "target_pixel"),
        (0, {"target_pixel": (1,)}, InvalidValueError, "target_pixel"),
        (0, {"target_pixel": (1j, 2)}, InvalidValueError, "target_pixel"),
        (0, {"target_pixel": "12"}, InvalidValueError, "target_pixel"),
        (0, {"target_pixel": ((1, 2), (1,))}, InvalidValueError, "target_pixel"),
    ],
)
def test_reset_refuses_bad_seeds_and_options_in_one_line(task_env, seed, options, kind, message):
    with pytest.raises(kind, match=message) as caught:
        task_env("reach").reset(seed=seed, options=options)
    assert "\n" not in str(caught.value)


def test_numpy_integers_are_seeds(task_env):
    env = task_env("reach")
    one, other = env.reset(seed=np.int64(5))[0], env.reset(seed=5)[0]
    np.testing.assert_array_equal(one["stripes"], other["stripes"])


@pytest.mark.parametrize(
    "action",
    [np.zeros(3, complex), np.array([1 + 0j, 0, 0]), ["a", "b", "c"], None, "x", [[0.0], [0.0, 1.0]], np.zeros(3, bool)],
)
def test_actions_that_are_not_real_numbers_are_refused_and_the_episode_goes_on(task_env, action):
    env = task_env("reach", bad_action="hold")
    env.reset(seed=3)
    with pytest.raises(InvalidValueError, match=r"action is .*; allowed: 3 finite numbers \(m/s\)"):
        env.step(action)
    env.step(np.zeros(3, np.float32))


def test_nothing_is_known_before_the_first_reset_and_after_the_end(task_env):
    env = task_env("reach")
    for call in (env.control_input, env.target_in_world, lambda: env.step(np.zeros(3, np.float32))):
        with pytest.raises(SimulationError, match=r"call reset\(\) first"):
            call()
    env.reset(seed=3)
    env.close()
    with pytest.raises(SimulationError, match=r"call reset\(\) first"):
        env.control_input()


def test_the_configuration_of_another_task_is_refused():
    with pytest.raises(InvalidValueError, match="config is 'ReachConfig'; allowed: a TrackConfig"):
        TrackEnv(ReachConfig(), perception="oracle")
    with pytest.raises(UnknownNameError, match="unknown task 'dance'"):
        make_environment("dance")


@pytest.mark.parametrize("perception", [3, None, object(), dict])
def test_an_estimator_without_an_estimate_is_refused(perception):
    with pytest.raises(InvalidValueError, match=r"perception is .*allowed: .*estimate\(image\)"):
        ReachEnv(perception=perception)


class Returning:
    """An estimator that is good for some frames and then returns something else."""

    def __init__(self, later, good_frames=0):
        self.later, self.good_frames = later, good_frames

    def estimate(self, image):
        self.good_frames -= 1
        return depth(90.0) if self.good_frames >= 0 else self.later


def depth(millimetres, shape=(256, 256)):
    return DepthEstimate(depth_mm=np.full(shape, millimetres, np.float32), valid=np.ones(shape, bool))


def test_a_users_own_estimator_takes_part(coarse_task):
    config = coarse_task("reach").config
    env = ReachEnv(config, perception=Returning(depth(90.0)))
    observation, info = env.reset(seed=0)
    env.close()
    assert np.all(observation["depth_mm"] == 90.0)
    assert info["depth_mae_mm"] > 1.0


def run(env, *, steps):
    for _ in range(steps):
        env.step(np.zeros(3, np.float32))


@pytest.mark.parametrize(
    ("returned", "message"),
    [
        (None, "estimate is 'nothing'; allowed: a DepthEstimate"),
        (np.zeros((256, 256)), "an array of float64"),
        (depth(90.0, (128, 256)), r"shape of the estimate is \(128, 256\)"),
        (depth(np.nan), "depth_mm of the estimate is nan"),
        (depth(-50.0), r"depth_mm of the estimate is -50\.0"),
    ],
)
def test_what_an_estimator_returns_is_checked_and_the_episode_does_not_go_on(coarse_task, returned, message):
    env = ReachEnv(coarse_task("reach").config, perception=Returning(returned, good_frames=2))
    env.reset(seed=3)
    with pytest.raises(InvalidValueError, match=message):
        run(env, steps=20)
    with pytest.raises(SimulationError, match=r"call reset\(\) first"):
        env.step(np.zeros(3, np.float32))
    env.close()


class Answering:
    """A controller that always answers the same."""

    def __init__(self, answer):
        self.answer = answer

    def reset(self):
        pass

    def command(self, state):
        return self.answer


@pytest.mark.parametrize("answer", [None, np.zeros(2), "left", np.zeros(3, complex), [0.0, 0.0], {"x": 1}])
def test_what_a_controller_answers_is_checked(answer):
    with pytest.raises(LaploopError, match=r"command of the controller is .*; allowed: 3 finite numbers \(velocity of the tip"):
        run_episode(EpisodeConfig.of(perception="oracle", seconds=0.1), controller=Answering(answer))


def test_what_a_residual_is_added_to_is_checked(coarse_task):
    config = replace(coarse_task("reach").config, action_mode="residual")
    env = ReachEnv(config, perception="oracle", controller=Answering(None))
    env.reset(seed=3)
    with pytest.raises(InvalidValueError, match="command of the controller is None"):
        env.step(np.zeros(3, np.float32))
    env.close()
