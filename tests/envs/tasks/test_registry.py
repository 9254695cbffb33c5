"""What every task must keep, whatever it is about."""

import itertools
import math
import os
import warnings
from dataclasses import replace
from pathlib import Path
from typing import get_args

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from laploop.envs.tasks.registry import TASKS, default_config, environment_id, task_spec
from laploop.envs.tasks.task_config import ActionMode, ObservationMode
from laploop.errors import InvalidValueError, UnknownNameError

ACTIONS, OBSERVATIONS = get_args(ActionMode), get_args(ObservationMode)

PAIRS = [
    # Each task with each action mode and each observation mode, every mode with another of the other kind.
    (task, action, OBSERVATIONS[(i + j) % 4])
    for i, task in enumerate(TASKS.names())
    for j, action in enumerate(ACTIONS)
]
# Reach has a test of its own.
CHECKED = [(task, ACTIONS[i % 4], OBSERVATIONS[(i + 1) % 4]) for i, task in enumerate(TASKS.names()) if task != "reach"]


def checked(task_env, task, action, observation):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = task_env(task, action_mode=action, observation_mode=observation)
        check_env(env, skip_render_check=True)


@pytest.mark.filterwarnings("ignore:.*is out of date:DeprecationWarning")
@pytest.mark.parametrize("task", TASKS.names())
def test_every_task_is_registered_under_its_name(task):
    env = gym.make(environment_id(task), perception="oracle")
    assert isinstance(env.unwrapped, task_spec(task).environment_class)
    assert env.unwrapped.task == task
    env.close()


@pytest.mark.parametrize(("task", "action", "observation"), CHECKED)
def test_gymnasiums_checker_passes_without_a_warning(task_env, task, action, observation):
    checked(task_env, task, action, observation)


@pytest.mark.slow
@pytest.mark.parametrize(("task", "action", "observation"), list(itertools.product(TASKS.names(), ACTIONS, OBSERVATIONS)))
def test_gymnasiums_checker_passes_in_every_mode(task_env, task, action, observation):
    checked(task_env, task, action, observation)


@pytest.mark.parametrize(("task", "action", "observation"), PAIRS)
def test_observations_are_what_their_mode_says(task_env, task, action, observation):
    env = task_env(task, action_mode=action, observation_mode=observation)
    seen, _ = env.reset(seed=5)
    assert env.observation_space.contains(seen)
    assert ("stripes" in seen) == (observation in {"all", "stripes"})
    assert ("depth_mm" in seen) == ("depth_valid" in seen) == (observation in {"all", "depth"})
    assert ("target_position" in seen) == (observation == "state")
    after, reward, *_, info = env.step(env.action_space.low)
    assert env.observation_space.contains(after)
    assert math.isfinite(reward)
    assert reward == pytest.approx(sum(info["reward_terms"].values()))


@pytest.mark.parametrize("task", TASKS.names())
def test_the_same_seed_gives_the_same_bits(task_env, task):
    traces = []
    for _ in range(2):
        env = task_env(task)
        rng = np.random.default_rng(1)
        trace = [env.reset(seed=5)[0]]
        rewards = []
        for _ in range(12):
            observation, reward, *_ = env.step(rng.uniform(-0.05, 0.05, 3).astype(np.float32))
            trace.append(observation)
            rewards.append(reward)
        traces.append((trace, rewards))
    (first, first_rewards), (second, second_rewards) = traces
    assert first_rewards == second_rewards
    for one, other in zip(first, second, strict=True):
        for key, value in one.items():
            np.testing.assert_array_equal(value, other[key], err_msg=key)


@pytest.mark.parametrize("task", TASKS.names())
def test_reward_terms_are_those_that_can_be_weighted(task_env, task):
    env = task_env(task)
    env.reset(seed=5)
    *_, info = env.step(np.zeros(3, np.float32))
    assert set(info["reward_terms"]) == set(vars(env.config.rewards))


@pytest.mark.parametrize("task", TASKS.names())
def test_every_task_has_a_page_that_names_its_observations_rewards_and_info(task_env, task):
    page = (Path(__file__).parents[3] / "docs" / "tasks" / f"{task}.md").read_text()
    env = task_env(task, observation_mode="state")
    env.reset(seed=5)
    *_, info = env.step(np.zeros(3, np.float32))
    common = (Path(__file__).parents[3] / "docs" / "tasks" / "README.md").read_text()
    for name in (*env.observation_space, *info):
        assert f"`{name}`" in page + common, name
    for name in (*info["reward_terms"], *env.metrics()):
        assert f"`{name}`" in page, name


def test_unknown_names_are_answered_with_those_that_exist():
    with pytest.raises(UnknownNameError, match="available: look, palpate, reach, scan, track"):
        task_spec("dance")
    config = default_config("track")
    with pytest.raises(UnknownNameError, match=r"unknown action mode .push.; available: joint-velocity"):
        replace(config, action_mode="push")
    with pytest.raises(UnknownNameError, match="unknown observation mode"):
        replace(config, observation_mode="sound")
    with pytest.raises(UnknownNameError, match="available: hold, raise"):
        replace(config, bad_action="guess")


@pytest.mark.parametrize("task", TASKS.names())
def test_configurations_that_make_no_sense_are_refused(task):
    config = default_config(task)
    for name in ("max_seconds", "max_tip_speed_mps", "max_joint_speed_radps", "harm_force_n", "yield_force_n"):
        with pytest.raises(InvalidValueError, match=name):
            replace(config, **{name: 0.0})


@pytest.mark.slow
def test_twenty_thousand_random_steps_leave_neither_nan_nor_growing_memory(task_env):
    def resident_mb():
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 2**20

    warm_mb = None
    for repetition, task in itertools.product(range(2), TASKS.names()):
        env = task_env(task, motion=default_config("track").loop.theatre.motion)
        rng = np.random.default_rng(repetition)
        observation, _ = env.reset(seed=repetition)
        for step in range(2000):
            if step % 25 == 0:
                # Held for a while, so that the tip gets somewhere: to tissue, to limits, out of view.
                action = rng.uniform(env.action_space.low, env.action_space.high).astype(np.float32)
            observation, reward, terminated, truncated, _ = env.step(action)
            assert math.isfinite(reward)
            if terminated or truncated:
                observation, _ = env.reset(seed=1000 * repetition + step)
            assert all(np.isfinite(value).all() for value in observation.values())
        env.close()
        if repetition == 0:
            warm_mb = resident_mb()
    # One theatre takes about 100 MB; ten of them that were kept would show.
    assert resident_mb() - warm_mb < 300.0
