"""What the timing of each stage does to whole episodes, with exact depth."""

import json
from pathlib import Path

import numpy as np
import pytest

from laploop.envs.loop.proprioception import ProprioceptionConfig
from laploop.envs.loop.timing.config import TimingConfig
from laploop.envs.loop.timing.latency import ConstantLatency, LognormalLatency, MeasuredLatency, TraceLatency
from laploop.envs.theatre.actuation import ActuationConfig
from laploop.envs.theatre.organ_motion import BaseMotion

MS = 1_000_000
STILL = np.zeros(3)
STORED = json.loads((Path(__file__).parent / "episodes.json").read_text())
"""Every sixth tick of episodes that were run before stages other than perception and transfer had a timing."""


def constant(ms):
    return ConstantLatency(latency_ms=ms)


def states(env, run_task, seed=4):
    """Play an episode; return the joint state at every tick, bit by bit, with the times of the newest depth frame."""
    found = []

    def watch(env):
        served, data = env.loop.newest_served, env.loop.theatre.data
        found.append((env.loop.now_ns, served.captured_ns, served.available_ns, data.qpos.tobytes(), data.qvel.tobytes()))

    infos = run_task(env, seed=seed, watch=watch)
    return infos, found


def servo_inputs(env, velocity, seed=3):
    """Return the tool's servo inputs in 24 physics steps, (24, 6) rad, while the tip is to move with a velocity."""
    env.reset(seed=seed)
    theatre, found = env.loop.theatre, []
    stepping = theatre.stepping

    def watched():
        yield from stepping()
        found.append(theatre.data.ctrl[theatre.tool_arm.actuator_indices].copy())

    theatre.stepping = watched
    for _ in range(6):
        env.loop.advance(velocity)
    return np.array(found)


@pytest.mark.parametrize("name", STORED)
def test_the_defaults_do_what_was_done_before_there_was_a_timing(task_env, run_task, name):
    changes = {}
    if name == "delayed":
        changes = {
            "motion": BaseMotion.named("both"),
            "actuation": ActuationConfig.named("ur5-cb"),
            "timing": TimingConfig(service=LognormalLatency(median_ms=20.0, sigma=0.3), transfer=constant(13.0)),
            "proprioception": ProprioceptionConfig(kinematics_delay_ms=6.0, force_delay_ms=4.0, force_noise_n=0.05),
        }
    found = {"now_ns": [], "captured_ns": [], "available_ns": [], "tip_in_world_m": []}

    def watch(env):
        served, loop = env.loop.newest_served, env.loop
        row = (loop.now_ns, served.captured_ns, served.available_ns, loop.theatre.tip_in_world().tolist())
        for series, value in zip(found.values(), row, strict=True):
            series.append(value)

    run_task(task_env("reach", max_seconds=0.8, **changes), seed=4, watch=watch)
    stored = STORED[name]
    for series in ("now_ns", "captured_ns", "available_ns"):
        assert found[series][::6] == stored[series]
    # Metres; equal to the bit on the machine that stored them.
    np.testing.assert_allclose(found["tip_in_world_m"][::6], stored["tip_in_world_m"], rtol=0.0, atol=1e-9)


def test_a_frame_is_observed_from_its_arrival_on_and_not_from_its_capture_on(task_env):
    timing = TimingConfig(exposure_ms=12.0, readout_ms=5.0, transfer=constant(9.0), service=constant(0.0))
    env = task_env("reach", observation_mode="stripes", timing=timing)
    observation, info = env.reset(seed=3)
    # Half an exposure, readout and transfer are 20 ms; the frame of time 0 is first seen at the tick at 24 ms.
    assert info["sim_s"] == 0.024
    first = observation["stripes"]
    images = {}
    for _ in range(5):
        observation, *_, info = env.step(np.array([0.03, 0.0, -0.03], np.float32))
        images[round(info["sim_s"] * 1e3)] = observation["stripes"]
    # The frame of 40 ms is there at 60 ms.
    assert all(np.array_equal(images[ms], first) for ms in (32, 40, 48, 56))
    assert not np.array_equal(images[64], first)
    np.testing.assert_array_equal(images[64], env.loop.newest_captured.truth.image)


def test_the_times_of_the_newest_used_frame_are_told(task_env):
    timing = TimingConfig(
        exposure_ms=4.0, readout_ms=1.0, transfer=constant(2.0), service=constant(20.0), pipeline=constant(6.5)
    )
    env = task_env("reach", timing=timing)
    _, info = env.reset(seed=3)
    assert info["frame_times"] is None
    *_, info = env.step(STILL)
    # Depth is there at 31.5 ms; no tick is before that of 32 ms.
    assert info["frame_times"] == {
        "index": 0,
        "captured_ns": 0,
        "arrived_ns": 5 * MS,
        "started_ns": 5 * MS,
        "finished_ns": 25 * MS,
        "available_ns": 31_500_000,
        "first_used_ns": 32 * MS,
        "worker": 0,
        "dropped": None,
    }
    assert info["depth_age_ms"] == 40.0


@pytest.mark.parametrize(("compute_ms", "transport_ms", "late_steps"), [(8.0, 0.0, 4), (3.0, 2.5, 3), (0.0, 0.001, 1)])
def test_a_command_takes_effect_as_many_whole_physics_steps_later(task_env, compute_ms, transport_ms, late_steps):
    late = TimingConfig(compute=constant(compute_ms), transport=constant(transport_ms))
    action = np.array([0.02, 0.01, -0.02])
    prompt, delayed, held = (
        servo_inputs(task_env("reach", timing=timing), velocity)
        for timing, velocity in ((TimingConfig(), action), (late, action), (late, STILL))
    )
    np.testing.assert_array_equal(delayed[:late_steps], held[:late_steps])
    np.testing.assert_array_equal(delayed[late_steps:], prompt[:-late_steps])
    assert not np.array_equal(prompt[0], held[0])


def test_a_command_that_a_later_one_overtook_never_takes_effect(task_env):
    env = task_env("reach", timing=TimingConfig(transport=TraceLatency(latencies_ms=(20.0, 2.0, 2.0, 2.0))))
    env.reset(seed=3)
    for _ in range(4):
        env.loop.advance(STILL)
    log = env.loop.timing_log
    # One of every four, sent at 0, 32, and 64 ms; those of 40 and 48 ms overtake that of 32 ms.
    assert [times.tick_ns // MS for times in log.commands if times.overtaken] == [0, 32]
    assert log.overtaken_commands == 2


def test_frames_are_lost_at_the_drop_rate_and_with_the_seed(task_env):
    lost = []
    for _ in range(2):
        env = task_env("reach", timing=TimingConfig(drop_rate=0.3, service=constant(2.0)), camera_hz=125.0)
        env.reset(seed=3)
        for _ in range(150):
            env.loop.advance(STILL)
        lost.append([times.index for times in env.loop.timing_log.frames if times.dropped == "lost"])
        assert env.loop.dropped_frames == len(lost[-1])
    assert lost[0] == lost[1]
    # 45 of 150 or so; the standard error is 5.6.
    assert 28 <= len(lost[0]) <= 62


def test_an_episode_of_measured_times_is_repeated_by_its_traces_to_the_bit(task_env, run_task):
    measured = task_env("reach", max_seconds=0.5, timing=TimingConfig(service=MeasuredLatency(), compute=MeasuredLatency()))
    _, first = states(measured, run_task)
    log = measured.loop.timing_log
    service, compute = (
        TraceLatency(latencies_ms=tuple(ns * 1e-6 for ns in times), order="in-order")
        for times in (log.service_ns, log.compute_ns)
    )
    assert min(log.compute_ns) > 0
    replayed = task_env("reach", max_seconds=0.5, timing=TimingConfig(service=service, compute=compute))
    _, second = states(replayed, run_task)
    assert first == second
    assert replayed.loop.timing_log == log


def test_controllers_know_how_late_commands_typically_are(task_env):
    env = task_env("reach", timing=TimingConfig(compute=constant(3.0), transport=LognormalLatency(median_ms=4.0)))
    env.reset(seed=3)
    assert env.control_input().lead_ns == 7 * MS
