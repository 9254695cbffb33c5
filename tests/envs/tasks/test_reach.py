import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from laploop.envs.loop.timing.config import TimingConfig
from laploop.envs.loop.timing.latency import ConstantLatency
from laploop.envs.tasks.configs import ReachConfig
from laploop.envs.tasks.reach import ReachEnv
from laploop.envs.tasks.registry import environment_id
from laploop.envs.theatre.organ_motion import BaseMotion
from laploop.errors import InvalidValueError, SimulationError, UnknownNameError


@pytest.fixture(scope="module")
def env(coarse_task):
    env = coarse_task("reach", motion=BaseMotion.named("both"), max_seconds=0.4)
    yield env
    env.close()


def rollout(env, seed, steps=30):
    observation, info = env.reset(seed=seed)
    rng = np.random.default_rng(1)
    trace = [observation]
    for _ in range(steps):
        observation, reward, *_, info = env.step(rng.uniform(-0.05, 0.05, 3).astype(np.float32))
        trace.append(observation)
    return trace, reward, info


def test_the_registered_environment_passes_gymnasiums_checker_without_a_warning_but_that_of_its_age(env):
    with pytest.warns(DeprecationWarning, match="upgrading to version `v1`"):
        made = gym.make(environment_id("reach"), config=env.config, perception="oracle")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(made.unwrapped, skip_render_check=True)
        made.close()


def test_the_same_seed_gives_the_same_bits(env):
    first, first_reward, first_info = rollout(env, seed=5)
    second, second_reward, second_info = rollout(env, seed=5)
    for one, other in zip(first, second, strict=True):
        for key, value in one.items():
            np.testing.assert_array_equal(value, other[key], err_msg=key)
    assert first_reward == second_reward
    assert first_info["target_error_mm"] == second_info["target_error_mm"]


def test_another_seed_gives_another_tissue_and_target(env):
    first, _ = env.reset(seed=5)
    second, _ = env.reset(seed=6)
    assert not np.array_equal(first["stripes"], second["stripes"])
    assert not np.array_equal(first["target_pixel"], second["target_pixel"])


def test_an_episode_starts_with_a_depth_map_of_known_age(env):
    observation, info = env.reset(seed=5)
    # The first frame is captured at 0 and arrives after the default 40 ms.
    assert info["depth_age_ms"] == 40.0
    assert observation["depth_age_s"][0] == pytest.approx(0.04)
    assert observation["depth_valid"].mean() > 0.9
    seen = observation["depth_mm"][observation["depth_valid"] == 1]
    assert 50.0 < np.median(seen) < 130.0


def test_an_episode_without_latency_starts_at_once(task_env):
    _, info = task_env("reach", timing=TimingConfig(service=ConstantLatency(latency_ms=0.0))).reset(seed=5)
    assert info["sim_s"] == info["depth_age_ms"] == info["contact_force_n"] == 0.0


def test_the_tip_follows_the_action_along_the_cameras_axes(env):
    for axis in range(3):
        before, _ = env.reset(seed=7)
        action = np.zeros(3, np.float32)
        action[axis] = -0.02
        for _ in range(20):
            after, *_ = env.step(action)
        moved = after["tip_position"] - before["tip_position"]
        # 20 periods at 20 mm/s make 3.2 mm, less the start's acceleration and the servo's lag (below 0.5 mm).
        assert moved[axis] == pytest.approx(-0.0032, abs=5e-4)
        assert np.abs(np.delete(moved, axis)).max() < 5e-5


def test_the_error_is_the_distance_from_an_ideal_touch(env):
    _, info = env.reset(seed=5)
    theatre, target = env.loop.theatre, env.surface_target()
    points = theatre.tissue.surface_points()
    # An ideal touch lies one ball radius (1.5 mm) above the target point along the normal there.
    ideal = target.position(points) + 0.0015 * target.normal(points)
    distance = np.linalg.norm(theatre.tip_in_world() - ideal) * 1e3
    assert info["target_error_mm"] == env.target_error_mm() == pytest.approx(distance)
    # The tip comes from above, so that forgetting the ball would add most of its radius.
    assert np.linalg.norm(theatre.tip_in_world() - target.position(points)) * 1e3 > distance + 0.5


def test_the_scripted_controller_succeeds_once_it_has_held_the_tip_on_the_target(task_env, run_task):
    env = task_env("reach")
    infos = run_task(env, seed=3)
    last, errors = infos[-1], np.array([info["target_error_mm"] for info in infos])
    assert (last["terminated_by"], last["success"]) == ("success", True)
    assert not any(info["success"] for info in infos[:-1])
    # 0.3 s are 37.5 ticks of 8 ms: the first whole number of them, each within 1.5 mm, and the tick before them was not.
    assert (errors[-38:] <= 1.5).all()
    assert errors[-39] > 1.5
    assert last["reward_terms"]["success"] == 10.0
    # With exact depth of tissue at rest the ball comes to lie within a tenth of a millimetre of where it should.
    assert errors[-1] < 0.2
    assert env.assessed(infos) == infos[-38:]


def test_leaving_the_target_starts_the_hold_over(task_env, monkeypatch):
    env = task_env("reach")
    # 30 ticks within the radius, one out of it, and again: success comes 38 ticks after the one outside.
    errors = iter([9.0, *[1.4] * 30, 1.6, *[1.5] * 60])
    monkeypatch.setattr(ReachEnv, "target_error_mm", lambda _: next(errors))
    env.reset(seed=3)
    ticks, terminated = 0, False
    while not terminated:
        *_, terminated, truncated, info = env.step(np.zeros(3, np.float32))
        ticks += 1
        assert not truncated
    assert (ticks, info["terminated_by"]) == (30 + 1 + 38, "success")


def test_the_target_is_the_tissue_under_the_chosen_pixel(env):
    env.reset(seed=5, options={"target_pixel": (120, 140)})
    camera = env.loop.rig.camera
    captured = env.loop.first_captured
    world_from_camera = captured.frame.world_from_camera
    point_in_camera = camera.unproject(np.array([120.5, 140.5]), captured.truth.depth_mm[140, 120] * 1e-3)
    expected = world_from_camera[:3, :3] @ point_in_camera + world_from_camera[:3, 3]
    # The tissue has moved with the base since that frame, along the world's z alone.
    offset = env.target_in_world() - expected
    assert np.abs(offset[:2]).max() < 2e-5
    assert abs(offset[2]) < 1e-3


def test_time_truncates_and_a_finished_episode_refuses_to_go_on(env):
    env.reset(seed=5)
    truncated = False
    while not truncated:
        *_, terminated, truncated, info = env.step(np.zeros(3, np.float32))
        assert not terminated
    assert info["terminated_by"] == "time"
    assert info["sim_s"] == pytest.approx(0.4)
    with pytest.raises(SimulationError, match="call reset"):
        env.step(np.zeros(3, np.float32))


@pytest.mark.parametrize("action", [np.full(3, np.nan), np.zeros(2), np.zeros((3, 1)), np.array([0.0, np.inf, 0.0])])
def test_impossible_actions_are_refused_before_anything_moves(env, action):
    env.reset(seed=5)
    before = env.loop.now_ns
    with pytest.raises(InvalidValueError, match="action"):
        env.step(action)
    assert env.loop.now_ns == before


def test_rewards_add_up_from_named_terms(env):
    env.reset(seed=5)
    _, reward, *_, info = env.step(np.array([0.01, 0.0, 0.0], np.float32))
    assert reward == pytest.approx(sum(info["reward_terms"].values()))
    assert set(info["reward_terms"]) == {"distance", "progress", "contact", "force", "effort", "success", "harm"}


def test_bad_configurations_are_refused():
    with pytest.raises(UnknownNameError, match=r"unknown estimator .magic.; available: .*oracle"):
        ReachEnv(perception="magic")
    with pytest.raises(InvalidValueError, match="max_seconds is 0"):
        ReachConfig(max_seconds=0)
