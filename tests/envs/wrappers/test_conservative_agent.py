"""Random delays behind a constant one."""

import numpy as np
import pytest

from laploop.envs.loop.timing.config import TimingConfig
from laploop.envs.loop.timing.latency import ConstantLatency, NormalLatency
from laploop.envs.wrappers.conservative_agent import ConservativeAgent
from laploop.errors import InvalidValueError

STILL = np.zeros(3, np.float32)


def played(env, count):
    env.reset(seed=3)
    return [env.step(STILL) for _ in range(count)]


def test_every_image_is_that_of_the_newest_frame_of_the_given_age_whatever_the_delays_below_it(task_env):
    some, others = (
        ConservativeAgent(task_env("reach", observation_mode="stripes", timing=TimingConfig(transfer=transfer)), 100.0)
        for transfer in (ConstantLatency(latency_ms=10.0), NormalLatency(mean_ms=50.0, sd_ms=15.0, max_ms=95.0))
    )
    shown = {}
    for env in (some, others):
        for observation, *_, info in played(env, 60):
            shown.setdefault(info["sim_s"], []).append(observation["stripes"])
            assert not info["late_frame"]
    # The episodes begin at different times; once a frame has been given time to age, the delays make no difference.
    settled_s = 0.1 + some.unwrapped.config.loop.camera_ns * 1e-9
    settled = [np.array_equal(*pair) for time_s, pair in shown.items() if len(pair) == 2 and time_s > settled_s]
    assert len(settled) > 30
    assert all(settled)


def test_the_age_of_depth_stays_within_a_camera_period_of_the_given_one(task_env):
    timing = TimingConfig(pipeline=NormalLatency(mean_ms=20.0, sd_ms=15.0, max_ms=60.0))
    env = ConservativeAgent(task_env("reach", observation_mode="depth", timing=timing), 120.0)
    camera_ms = env.unwrapped.config.loop.camera_ns * 1e-6
    ages_ms = [1e3 * float(observation["depth_age_s"][0]) for observation, *_ in played(env, 60)][30:]
    assert min(ages_ms) == pytest.approx(120.0, abs=8.0)
    assert max(ages_ms) < 120.0 + camera_ms
    assert len(set(np.round(ages_ms, 3))) == pytest.approx(camera_ms / 8.0)


def test_frames_that_come_too_late_are_shown_and_noted(task_env):
    env = ConservativeAgent(task_env("reach", observation_mode="depth"), 20.0)
    _, info = env.reset(seed=3)
    assert info["late_frame"]
    late = [info["late_frame"] for *_, info in (env.step(STILL) for _ in range(20))]
    assert 0 < sum(late) < 20


def test_observations_without_images_and_bad_ages_are_refused(task_env):
    with pytest.raises(InvalidValueError, match=r"observation space of ConservativeAgent .*one with images"):
        ConservativeAgent(task_env("reach", observation_mode="state"), 80.0)
    for age_ms in (0.0, -1.0, 6000.0, float("nan"), None):
        with pytest.raises(InvalidValueError, match=r"age_ms is .*above 0 and at most 5000"):
            ConservativeAgent(task_env("reach"), age_ms)
