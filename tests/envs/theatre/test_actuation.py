import math

import numpy as np
import pytest

from laploop.envs.theatre.actuation import Actuation, ActuationConfig
from laploop.envs.theatre.arm import JointReference
from laploop.errors import InvalidValueError, UnknownNameError

STEP_NS = 2_000_000
CONTROL_STEPS = 4
HOME = np.array([0.3, -1.2, 1.4, -0.4, 0.7, 0.1])
FEED_FORWARD_S = 0.007
"""Damping over stiffness of the servos."""


def make(config, q=HOME):
    return Actuation(config, q=q, timestep_ns=STEP_NS, control_steps=CONTROL_STEPS)


def positions_of(inputs, start):
    """Undo the velocity feed-forward: u = x + r (x - x_before) / h."""
    ratio = FEED_FORWARD_S / (STEP_NS * 1e-9)
    positions = [start]
    for u in inputs:
        positions.append((u + ratio * positions[-1]) / (1.0 + ratio))
    return np.array(positions[1:])


def step_response(config, size=0.01, steps=200):
    actuation = make(config)
    inputs = []
    for k in range(steps):
        if k % CONTROL_STEPS == 0:
            actuation.command(k * STEP_NS, HOME + size)
        inputs.append(actuation.step(k * STEP_NS))
    return positions_of(inputs, HOME) - HOME


def test_ideal_actuation_is_the_plain_reference_bit_for_bit():
    rng = np.random.default_rng(0)
    actuation = make(ActuationConfig())
    plain = JointReference(q=HOME, timestep_s=STEP_NS * 1e-9, control_steps=CONTROL_STEPS)
    for k in range(50):
        if k % CONTROL_STEPS == 0 and k != 24:  # one target is missing
            q, qdot = HOME + rng.normal(size=6), rng.normal(size=6)
            actuation.command(k * STEP_NS, q, qdot)
            plain.set_target(q, qdot)
        assert np.array_equal(actuation.step(k * STEP_NS), plain.advance())


@pytest.mark.parametrize("name", ["ur5-cb", "ur5-e"])
def test_step_response_has_the_stated_delay_and_lag(name):
    config = ActuationConfig.named(name)
    response = step_response(config)
    first = math.ceil(config.delay_ns / STEP_NS)
    ends_s = (np.arange(len(response)) + 1 - first) * STEP_NS * 1e-9
    exact = np.where(ends_s > 0.0, 0.01 * (1.0 - np.exp(-ends_s / (config.lag_ns * 1e-9))), 0.0)
    np.testing.assert_allclose(response, np.tile(exact[:, None], 6), atol=1e-12)  # rad, rounding


@pytest.mark.parametrize("name", ["ur5-cb", "ur5-e"])
def test_slow_motion_arrives_as_late_as_the_lead_says(name):
    config = ActuationConfig.named(name)
    actuation = make(config)
    hertz = 0.25
    inputs, ends_s = [], []
    for k in range(2500):
        if k % CONTROL_STEPS == 0:
            time_s = k * STEP_NS * 1e-9
            swing = 0.05 * np.sin(2.0 * np.pi * hertz * time_s)
            rate = 0.05 * 2.0 * np.pi * hertz * np.cos(2.0 * np.pi * hertz * time_s)
            actuation.command(k * STEP_NS, HOME + swing, np.full(6, rate))
        inputs.append(actuation.step(k * STEP_NS))
        ends_s.append((k + 1) * STEP_NS * 1e-9)
    moved = positions_of(inputs, HOME)[:, 0] - HOME[0]
    late = 0.05 * np.sin(2.0 * np.pi * hertz * (np.array(ends_s) - config.lead_ns * 1e-9))
    # 2.5 ms of timing (the physics step, the delay rounded to it) at the top speed of 0.0785 rad/s.
    np.testing.assert_allclose(moved[500:], late[500:], atol=2.5e-3 * 0.0785)


def test_targets_between_two_cycles_wait_for_the_next_one():
    actuation = make(ActuationConfig(cycle_ms=8.0))
    inputs = []
    for k in range(16):
        actuation.command(k * STEP_NS, HOME + 0.001 * k)
        inputs.append(actuation.step(k * STEP_NS))
    held = positions_of(inputs, HOME)[:, 0] - HOME[0]
    np.testing.assert_allclose(held, 0.001 * (np.arange(16) // 4 * 4), atol=1e-12)  # rad


def test_speed_and_angle_stay_within_their_limits():
    config = ActuationConfig(cycle_ms=STEP_NS * 1e-6, max_speed_rad_s=0.5, max_angle_rad=2.0)
    actuation = make(config)
    inputs = []
    for k in range(1500):
        actuation.command(k * STEP_NS, HOME + 5.0)
        inputs.append(actuation.step(k * STEP_NS))
    positions = np.vstack([HOME, positions_of(inputs, HOME)])
    speeds = np.diff(positions, axis=0) / (STEP_NS * 1e-9)
    assert np.abs(speeds).max() == pytest.approx(0.5, rel=1e-9)
    assert positions.max() == pytest.approx(2.0, abs=1e-9)
    assert positions.max() <= 2.0 + 1e-9


def test_arm_stands_where_a_stream_of_moving_targets_broke_off():
    actuation = make(ActuationConfig.named("ur5-cb"))
    for k in range(2000):
        if k % CONTROL_STEPS == 0 and k < 100:
            actuation.command(k * STEP_NS, HOME + 0.2 * k * STEP_NS * 1e-9, np.full(6, 0.2))
        last = actuation.step(k * STEP_NS)
    expected = HOME + 0.2 * (96 + CONTROL_STEPS) * STEP_NS * 1e-9  # one period beyond the last target
    np.testing.assert_allclose(last, expected, atol=1e-9)


def test_reset_forgets_targets_under_way():
    actuation = make(ActuationConfig.named("ur5-e"))
    actuation.command(0, HOME + 1.0)
    for k in range(10):
        actuation.step(k * STEP_NS)
    actuation.reset(HOME)
    for k in range(100):
        assert np.array_equal(actuation.step(k * STEP_NS), HOME)


def test_nothing_moves_before_the_first_target():
    actuation = make(ActuationConfig.named("ur5-cb"))
    assert all(np.array_equal(actuation.step(k * STEP_NS), HOME) for k in range(50))


@pytest.mark.parametrize("name", ["ideal", "ur5-cb"])
def test_target_that_is_not_a_number_is_refused_and_leaves_the_arm_alone(name):
    actuation = make(ActuationConfig.named(name))
    with pytest.raises(InvalidValueError, match="q is"):
        actuation.command(0, np.full(6, np.nan))
    with pytest.raises(InvalidValueError, match="qdot"):
        actuation.command(0, HOME, np.zeros(5))
    assert np.array_equal(actuation.step(0), HOME)


def test_time_does_not_go_back():
    actuation = make(ActuationConfig.named("ur5-cb"))
    actuation.command(8_000_000, HOME)
    with pytest.raises(InvalidValueError, match="now_ns"):
        actuation.command(0, HOME)


@pytest.mark.parametrize(
    "fields",
    [
        {"cycle_ms": -1.0},
        {"delay_ms": 1.0},
        {"lag_ms": 1.0},
        {"max_speed_rad_s": 1.0},
        {"cycle_ms": 8.0, "max_angle_rad": 0.0},
        {"cycle_ms": 8.0, "lag_ms": -1.0},
    ],
)
def test_impossible_robots_are_refused(fields):
    with pytest.raises(InvalidValueError):
        ActuationConfig(**fields)


def test_cycle_must_fit_the_physics_step():
    with pytest.raises(InvalidValueError, match="multiple of the physics step"):
        make(ActuationConfig(cycle_ms=3.0))


def test_start_beyond_the_limit_is_refused():
    with pytest.raises(InvalidValueError, match="finite angles"):
        make(ActuationConfig.named("ur5-cb"), q=np.full(6, 7.0))


def test_unknown_name_lists_those_that_exist():
    with pytest.raises(UnknownNameError, match="ideal, ur5-cb, ur5-e"):
        ActuationConfig.named("ur10")
