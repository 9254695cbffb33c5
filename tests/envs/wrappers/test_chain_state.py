"""Wrapped environments: states, copies and pickles take in what the wrappers remember."""

import copy
import functools
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import OrderEnforcing, TimeLimit

from laploop.envs import AsyncPolicy, AsyncPolicyConfig, NormalLatency, get_state, set_state
from laploop.envs.loop.timing.config import TimingConfig
from laploop.envs.wrappers.action_history import ActionHistory
from laploop.envs.wrappers.age_aware_frame_stack import AgeAwareFrameStack
from laploop.envs.wrappers.conservative_agent import ConservativeAgent
from laploop.envs.wrappers.delay_randomization import DelayRandomization
from laploop.envs.wrappers.goal_conditioned import GoalConditioned
from laploop.errors import InvalidValueError

RANDOM = TimingConfig(service=NormalLatency(mean_ms=60.0, sd_ms=20.0))


def images(make):
    """Wrap an environment of images in all that fits it."""
    env = DelayRandomization(make("reach", "stripes"), (10.0, 60.0))
    env = AgeAwareFrameStack(ConservativeAgent(env, 90.0), 3)
    return ActionHistory(TimeLimit(OrderEnforcing(env), 50), 4)


def vectors(make):
    """Wrap an environment of vectors in all that fits it."""
    return ActionHistory(GoalConditioned(make("reach")), 3)


def thinking(make):
    """Wrap the task's own environment in a policy that thinks for random times."""
    return AsyncPolicy(make("reach").task_env, AsyncPolicyConfig(think=NormalLatency(mean_ms=20.0, sd_ms=8.0)))


def run(env, count):
    """Return all observations and rewards of some steps."""
    high, seen = env.action_space.high, []
    for step in range(count):
        observation, reward, terminated, truncated, _ = env.step((high * np.sin(step / 3) / 3).astype(np.float32))
        flat = gym.spaces.flatten(env.observation_space, observation)
        seen.append(np.concatenate([np.asarray(flat, np.float64), [float(reward), terminated, truncated]]))
    return np.array(seen)


@pytest.mark.parametrize("wrapped", [images, vectors, thinking])
def test_the_state_of_a_wrapped_environment_goes_on_to_the_same_bits_in_it_in_a_fresh_one_and_in_a_copy(decisions, wrapped):
    env, fresh = wrapped(decisions), wrapped(decisions)
    env.reset(seed=3)
    run(env, 5)
    state, copied = get_state(env), copy.deepcopy(env)
    expected = run(env, 6)
    set_state(env, state)
    np.testing.assert_array_equal(run(env, 6), expected)
    set_state(fresh, pickle.loads(pickle.dumps(state)))  # noqa: S301  our own bytes
    np.testing.assert_array_equal(run(fresh, 6), expected)
    np.testing.assert_array_equal(run(copied, 6), expected)
    copied.close()


@pytest.mark.filterwarnings("ignore:.*different from the unwrapped version")
@pytest.mark.parametrize("wrapped", [images, vectors])
def test_gymnasiums_checker_accepts_wrapped_environments(decisions, wrapped):
    check_env(wrapped(decisions), skip_render_check=True)


def test_a_state_of_other_wrappers_or_arguments_is_refused(decisions):
    env = ActionHistory(decisions(), 3)
    state = env.get_state()
    with pytest.raises(InvalidValueError, match=r"wrappers of the state is .*ActionHistory.*allowed: .*GoalConditioned"):
        GoalConditioned(decisions()).set_state(state)
    with pytest.raises(InvalidValueError, match=r"arguments of ActionHistory in the state is {'k': 3}; allowed: {'k': 4}"):
        ActionHistory(decisions(), 4).set_state(state)
    with pytest.raises(InvalidValueError, match="state is 'bytes'"):
        env.set_state(b"")


def test_other_environments_are_refused():
    with pytest.raises(InvalidValueError, match="env is 'CartPoleEnv'; allowed: the environment of a laploop task"):
        ActionHistory(gym.make("CartPole-v1"))


@pytest.mark.slow
def test_vector_environments_in_spawned_processes_make_the_environments_by_their_ids():
    make = functools.partial(gym.make, "laploop:laploop/Reach-v1", observation="depth", perception="oracle")
    env = gym.vector.AsyncVectorEnv([make], context="spawn")
    one = make()
    observations, _ = env.reset(seed=4)
    expected, _ = one.reset(seed=4)
    for name, values in expected.items():
        np.testing.assert_array_equal(observations[name][0], values)
    env.close()
    one.close()


@pytest.mark.slow
def test_stable_baselines_runs_the_environments_in_spawned_processes():
    vec_env = pytest.importorskip("stable_baselines3.common.vec_env")
    env = vec_env.SubprocVecEnv(
        [functools.partial(gym.make, "laploop:laploop/Reach-v1", observation="depth", perception="oracle")], "spawn"
    )
    observations = env.reset()
    assert observations["depth"].shape == (1, 256, 256, 1)
    env.step(np.zeros((1, 3), np.float32))
    env.close()
