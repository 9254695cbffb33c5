"""A delay drawn for each episode."""

import numpy as np
import pytest

from laploop.envs.loop.timing.config import TimingConfig
from laploop.envs.loop.timing.latency import ConstantLatency, LognormalLatency
from laploop.envs.wrappers.delay_randomization import DelayRandomization
from laploop.errors import InvalidValueError, UnknownNameError

STILL = np.zeros(3, np.float32)


def test_each_episode_has_a_delay_of_its_own_that_its_frames_then_have(task_env):
    env = DelayRandomization(task_env("reach", observation_mode="depth"), (10.0, 90.0))
    drawn = []
    for seed in (7, None, None):
        _, info = env.reset(seed=seed)
        drawn.append(info["delay_ms"])
        # 40 ms of perception on top.
        times = env.unwrapped.loop.timing_log.frames[0]
        assert times.available_ns - times.captured_ns == round(1e6 * drawn[-1]) + 40_000_000
        assert env.step(STILL)[-1]["delay_ms"] == drawn[-1]
    assert len(set(drawn)) == 3
    assert all(10.0 <= delay_ms <= 90.0 for delay_ms in drawn)
    again = DelayRandomization(task_env("reach", observation_mode="depth"), (10.0, 90.0))
    assert again.reset(seed=7)[1]["delay_ms"] == drawn[0]
    assert again.reset()[1]["delay_ms"] == drawn[1]


def test_a_model_is_drawn_from_once_an_episode_and_other_stages_stay_as_configured(task_env):
    timing = TimingConfig(pipeline=ConstantLatency(latency_ms=8.0))
    env = task_env("reach", observation_mode="depth", timing=timing)
    wrapped = DelayRandomization(env, LognormalLatency(median_ms=30.0), stage="service")
    _, info = wrapped.reset(seed=1)
    assert set(env.loop.timing_log.service_ns) == {round(1e6 * info["delay_ms"])}
    assert env.loop.timing.pipeline == timing.pipeline
    assert env.config.loop.timing == timing


def test_commands_are_delayed_by_the_transport_and_controllers_know_it(task_env):
    env = task_env("reach", observation_mode="state")
    _, info = DelayRandomization(env, (20.0, 40.0), stage="transport").reset(seed=1)
    assert env.control_input().lead_ns == round(1e6 * info["delay_ms"])


def test_a_stage_that_delays_nothing_that_is_observed_is_refused(task_env):
    with pytest.raises(InvalidValueError, match="stage is 'transfer'; allowed: transport: the others delay nothing"):
        DelayRandomization(task_env("reach", observation_mode="state"))
    with pytest.raises(InvalidValueError, match="stage is 'service'; allowed: transport, transfer"):
        DelayRandomization(task_env("reach", observation_mode="stripes"), stage="service")


def test_bad_bounds_and_stages_are_refused(task_env):
    env = task_env("reach")
    for delay in ((5.0, 1.0), (-1.0, 1.0), (0.0, 6000.0), (0.0, float("nan")), 10.0):
        with pytest.raises(InvalidValueError, match=r"delay is .*a latency model, or bounds in ms"):
            DelayRandomization(env, delay)
    with pytest.raises(UnknownNameError, match="unknown stage 'servise'; did you mean 'service'"):
        DelayRandomization(env, stage="servise")
