import time

import gymnasium as gym
import numpy as np
import pytest

from laploop.envs.async_policy import AsyncPolicy, AsyncPolicyConfig
from laploop.envs.loop.timing.latency import ConstantLatency, LognormalLatency, MeasuredLatency, TraceLatency
from laploop.errors import InvalidValueError, SimulationError

ACTIONS = np.array([[0.01 * (index + 1), 0.0, -0.002 * index] for index in range(5)], np.float32)


@pytest.fixture
def policy_env(task_env):
    """Make an environment with thought; what its inner steps were given is in its list `given`."""

    def make(**config):
        inner = task_env("reach", observation_mode="state")
        env = AsyncPolicy(inner, AsyncPolicyConfig(**config))
        env.given = []
        step = inner.step
        inner.step = lambda action: (env.given.append(np.array(action)), step(action))[1]
        return env

    return make


def speeds(env):
    """Return the first components of what the inner steps were given, in cm/s."""
    return [round(100.0 * float(action[0]), 3) for action in env.given]


def test_without_thought_it_is_the_plain_environment_to_the_bit(task_env):
    plain, wrapped = task_env("reach"), AsyncPolicy(task_env("reach"))
    first, second = plain.reset(seed=3)[0], wrapped.reset(seed=3)[0]
    for action in (*ACTIONS, *ACTIONS):
        for name, value in first.items():
            np.testing.assert_array_equal(second[name], value)
        first, reward, *ends, info = plain.step(action)
        second, other, *others, more = wrapped.step(action)
        assert (reward, ends) == (other, others)
        assert {name: more[name] for name in info} == info
        assert (more["action_age_ms"], more["late_ticks"]) == (0.0, 0)
    np.testing.assert_array_equal(plain.loop.theatre.data.qpos, wrapped.unwrapped.loop.theatre.data.qpos)


@pytest.mark.parametrize(("think_ms", "late"), [(8.0, 1), (8.1, 2), (24.0, 3)])
def test_an_action_arrives_as_many_ticks_later_as_was_thought(policy_env, think_ms, late):
    env = policy_env(think=ConstantLatency(latency_ms=think_ms))
    env.reset(seed=3)
    ages, begin_ns = [], env.unwrapped.loop.now_ns
    for action in ACTIONS[:3]:
        *_, info = env.step(action)
        ages.append(info["action_age_ms"])
    # The first action is computed from the observation at 0 and acts from tick `late` on, for as long as the next takes.
    assert speeds(env) == [0.0] * late + [1.0] * late + [2.0] * late
    assert env.unwrapped.loop.now_ns - begin_ns == 3 * late * 8_000_000
    # In its last tick it is 2 late - 1 ticks old.
    assert ages == [None, 8.0 * (2 * late - 1), 8.0 * (2 * late - 1)]
    assert (info["think_ms"], info["late_ticks"]) == (think_ms, late)


def test_a_stale_action_is_held_or_replaced_by_zero(policy_env):
    env = policy_env(think=ConstantLatency(latency_ms=24.0), stale="zero")
    env.reset(seed=3)
    for action in ACTIONS[:2]:
        env.step(action)
    assert speeds(env) == [0.0, 0.0, 0.0, 1.0, 0.0, 0.0]


def test_a_chunk_is_played_an_action_a_tick_while_the_next_is_thought_of(policy_env):
    env = policy_env(think=ConstantLatency(latency_ms=16.0), ticks=4)
    env.reset(seed=3)
    for _ in range(2):
        env.step(ACTIONS)
    # Given at 0 and at 4, arriving at 2 and at 6.
    assert speeds(env) == [0.0, 0.0, 1.0, 2.0, 3.0, 4.0, 1.0, 2.0]
    env = policy_env(think=ConstantLatency(latency_ms=16.0), ticks=4, chunk_begins="observation")
    env.reset(seed=3)
    for _ in range(2):
        env.step(ACTIONS)
    # The first two actions of each were meant for ticks that have passed.
    assert speeds(env) == [0.0, 0.0, 3.0, 4.0, 5.0, 5.0, 3.0, 4.0]


def test_rewards_of_the_ticks_are_added_and_the_end_is_not_passed(task_env):
    plain = task_env("reach", observation_mode="state", max_seconds=0.1)
    env = AsyncPolicy(
        task_env("reach", observation_mode="state", max_seconds=0.1), AsyncPolicyConfig(think=ConstantLatency(latency_ms=40.0))
    )
    plain.reset(seed=3)
    env.reset(seed=3)
    rewards = [plain.step(np.zeros(3, np.float32))[1] for _ in range(8)]
    steps = [env.step(ACTIONS[0]) for _ in range(2)]
    assert steps[0][1] == pytest.approx(sum(rewards[:5]))
    # From 40 ms on, 60 ms are eight ticks, of which the second step has the last three.
    assert [truncated for *_, truncated, _ in steps] == [False, True]
    assert steps[1][-1]["sim_s"] == pytest.approx(0.104)
    with pytest.raises(SimulationError):
        env.step(ACTIONS[0])


def test_think_times_are_drawn_by_the_seed(policy_env):
    env = policy_env(think=LognormalLatency(median_ms=10.0, sigma=0.5))
    drawn = []
    for seed in (3, 3, 4):
        env.reset(seed=seed)
        for action in ACTIONS:
            env.step(action)
        drawn.append(env.think_ns)
    assert drawn[0] == drawn[1] != drawn[2]


def test_measured_thought_is_repeated_by_its_trace(policy_env):
    measured = policy_env(think=MeasuredLatency())
    measured.reset(seed=3)
    for action in ACTIONS[:3]:
        time.sleep(0.012)
        *_, info = measured.step(action)
    assert info["late_ticks"] >= 2
    trace = TraceLatency(latencies_ms=tuple(ns * 1e-6 for ns in measured.think_ns))
    replayed = policy_env(think=trace)
    replayed.reset(seed=3)
    for action in ACTIONS[:3]:
        replayed.step(action)
    np.testing.assert_array_equal(measured.given, replayed.given)
    assert measured.think_ns == replayed.think_ns


def test_what_it_cannot_use_is_refused(policy_env):
    with pytest.raises(InvalidValueError, match="env is 'CartPoleEnv'; allowed: the environment of a laploop task"):
        AsyncPolicy(gym.make("CartPole-v1"))
    env = policy_env()
    with pytest.raises(SimulationError, match="no episode is running"):
        env.step(ACTIONS[0])
    env.reset(seed=3)
    for action in (np.zeros(4), np.zeros((2, 4)), np.zeros((0, 3)), np.float32(0.0)):
        with pytest.raises(InvalidValueError, match=r"shape of the action is .*; allowed: \(3,\), or \(n, 3\)"):
            env.step(action)
