"""A state, a copy and a pickle go on to the same bits as what they were taken from."""

import copy
import pickle
import threading
from pathlib import Path

import numpy as np
import pytest

from laploop.envs.loop.faults import Fault
from laploop.envs.loop.kinematic_errors import KinematicErrors
from laploop.envs.loop.proprioception import ProprioceptionConfig
from laploop.envs.loop.timing.config import TimingConfig
from laploop.envs.loop.timing.latency import GammaLatency, LognormalLatency, NormalLatency, TraceLatency
from laploop.envs.recording.recorder import NullRecorder
from laploop.envs.sensors.optics.exposure_control import ExposureControl
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.envs.tasks.reach import ReachEnv
from laploop.envs.theatre.actuation import ActuationConfig
from laploop.envs.theatre.organ_motion import BaseMotion
from laploop.errors import InvalidValueError

LATE = TimingConfig(
    exposure_ms=8.0,
    transfer=GammaLatency(mean_ms=15.0, sd_ms=12.0),
    drop_rate=0.1,
    service=LognormalLatency(median_ms=60.0, sigma=0.4, hold_probability=0.3),
    pipeline=NormalLatency(mean_ms=20.0, sd_ms=15.0),
    workers=2,
    queue="fifo",
    capacity=2,
    compute=TraceLatency(latencies_ms=(1.0, 4.0, 2.0), order="shuffle"),
    transport=TraceLatency(latencies_ms=(0.0, 3.0)),
)
EVERYTHING = {
    "action_mode": "residual",
    "observation_mode": "depth",
    "marker": True,
    "motion": BaseMotion.named("both"),
    "actuation": ActuationConfig.named("ur5-cb"),
    "timing": LATE,
    "proprioception": ProprioceptionConfig(kinematics_delay_ms=6.0, force_delay_ms=4.0, force_noise_n=0.02),
    "kinematic_errors": KinematicErrors(joint_rad=1e-3, tip_m=5e-4, hand_eye_m=5e-4),
    "faults": (
        Fault(kind="late-frame", start_s=0.5, end_s=0.9),
        Fault(kind="target-hidden", start_s=1.5, end_s=1.8),
        Fault(kind="depth-jump", start_s=2.0, end_s=2.3),
    ),
}


def pickled(value):
    """Return a copy by way of a pickle."""
    return pickle.loads(pickle.dumps(value))  # noqa: S301  our own bytes


def steps(env, count):
    """Run an environment with actions that depend on the step alone; return all that it gives."""
    seen = []
    for step in range(count):
        action = env.action_space.high * np.sin(np.arange(env.action_space.shape[0]) + step / 9).astype(np.float32) / 4
        observation, reward, terminated, truncated, info = env.step(action)
        seen.append((observation, reward, terminated, truncated, info["depth_age_ms"], info["contact_force_n"], info["frames"]))
        if terminated or truncated:
            break
    return seen


def assert_same(some, others):
    """Compare two outcomes of `steps` to the bit."""
    assert len(some) == len(others)
    for (observation, *rest), (other, *others_rest) in zip(some, others, strict=True):
        assert rest == others_rest
        for name, values in observation.items():
            np.testing.assert_array_equal(values, other[name], err_msg=name)


def in_flight(env):
    """Return how many frames are under way from the camera to consumers."""
    return sum(times.available_ns is None and times.dropped is None for times in env.loop.timing_log.frames)


@pytest.mark.parametrize(
    ("task", "changes"),
    [
        ("reach", {"observation_mode": "state"}),
        ("palpate", {"observation_mode": "stripes", "timing": LATE}),
        ("track", {"observation_mode": "all", "motion": BaseMotion.named("both")}),
        ("scan", {"observation_mode": "depth", "motion": BaseMotion.named("breathing"), "timing": LATE}),
        ("track", EVERYTHING),
        ("look", {"observation_mode": "stripes", "optics": StripeOptics(exposure_control=ExposureControl(gain=0.8))}),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_state_goes_on_to_the_same_bits_where_it_was_taken_and_in_a_fresh_environment(task_env, task, changes):
    env = task_env(task, **changes)
    env.reset(seed=3)
    steps(env, 17)
    assert in_flight(env) > 0
    state = env.get_state()
    expected = steps(env, 25)
    env.set_state(state)
    assert_same(expected, steps(env, 25))
    fresh = task_env(task, **changes)
    fresh.set_state(pickled(state))
    assert_same(expected, steps(fresh, 25))


@pytest.mark.slow
def test_500_steps_with_motion_prediction_faults_delays_and_noise_are_the_same_to_the_bit(task_env):
    env, fresh = task_env("track", **EVERYTHING), task_env("track", **EVERYTHING)
    env.reset(seed=11)
    # The search for rhythms is under way.
    steps(env, 450)
    assert in_flight(env) > 1
    state = env.get_state()
    expected = steps(env, 500)
    assert len(expected) == 500
    fresh.reset(seed=12)
    fresh.set_state(state)
    assert_same(expected, steps(fresh, 500))


def test_the_next_reset_without_a_seed_is_the_same_too(task_env):
    env, fresh = task_env("reach", observation_mode="state"), task_env("reach", observation_mode="state")
    env.reset(seed=5)
    fresh.set_state(env.get_state())
    env.reset()
    fresh.reset()
    assert_same(steps(env, 5), steps(fresh, 5))


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, pickled])
def test_a_copy_and_its_original_go_separate_ways(task_env, copied):
    env = task_env("reach", observation_mode="depth", timing=LATE)
    env.reset(seed=3)
    steps(env, 10)
    other = copied(env)
    again = copied(other)
    try:
        expected = steps(env, 25)
        assert_same(expected, steps(other, 25))
        assert_same(expected, steps(again, 25))
    finally:
        other.close()
        again.close()


def test_a_copy_before_the_first_reset_and_after_the_end_behaves_as_its_original(task_env):
    env = task_env("reach", observation_mode="state", max_seconds=0.1)
    before = copy.deepcopy(env)
    env.reset(seed=4)
    before.reset(seed=4)
    expected = steps(env, 100)
    assert_same(expected, steps(before, 100))
    env.close()
    after = copy.deepcopy(env)
    after.reset(seed=4)
    assert_same(expected, steps(after, 100))
    before.close()
    after.close()


def test_copies_and_states_leak_neither_threads_nor_descriptors(task_env):
    env = task_env("reach", observation_mode="stripes", timing=LATE)
    env.reset(seed=3)

    def held():
        return threading.active_count(), len(list(Path("/proc/self/fd").iterdir()))

    def use():
        other = copy.deepcopy(env)
        steps(other, 6)
        other.close()
        env.set_state(env.get_state())
        steps(env, 6)

    use()
    before = held()
    for _ in range(3):
        use()
    assert held() == before


def test_recorders_are_not_copied_and_see_the_scene_of_a_state_begin(task_env, monkeypatch):
    env = task_env("reach", observation_mode="state")
    env.reset(seed=3)
    begun = []
    monkeypatch.setattr(NullRecorder, "begin", lambda recorder, *_: begun.append(recorder))
    other = copy.deepcopy(env)
    assert other.loop.recorder is not env.loop.recorder
    assert begun == [other.loop.recorder]
    env.set_state(other.get_state())
    assert begun == [other.loop.recorder]
    other.close()


def test_a_state_of_something_else_is_refused_with_the_difference(task_env):
    env = task_env("reach", observation_mode="state", max_seconds=3.0)
    state = env.get_state()
    other_timing = task_env("reach", observation_mode="state", max_seconds=3.0, timing=TimingConfig(drop_rate=0.5))
    with pytest.raises(InvalidValueError, match=r"config\.loop\.timing\.drop_rate of the state is 0\.0; allowed: 0\.5"):
        other_timing.set_state(state)
    with pytest.raises(InvalidValueError, match=r"environment of the state is .*ReachEnv.*allowed: .*TrackEnv"):
        task_env("track", observation_mode="state").set_state(state)
    with pytest.raises(InvalidValueError, match="perception of the state is 'oracle'; allowed: 'phase'"):
        ReachEnv(env.config, perception="phase").set_state(state)
    with pytest.raises(InvalidValueError, match="state is 'bytes'; allowed: what get_state"):
        env.set_state(b"")


def test_what_cannot_be_pickled_is_named(task_env):
    env = task_env("reach", observation_mode="state")
    env.lock = threading.Lock()
    with pytest.raises(InvalidValueError, match="lock"):
        env.get_state()
