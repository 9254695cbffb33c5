"""Nominal kinematics, and the truth that the simulator knows."""

import numpy as np
import pytest

from laploop.envs.loop.kinematic_errors import KinematicErrors
from laploop.envs.theatre.actuation import ActuationConfig

ERRORS = KinematicErrors(joint_rad=2e-3, tip_m=5e-4, hand_eye_m=5e-4, hand_eye_rad=3e-3)


@pytest.fixture
def erring(task_env):
    env = task_env("reach", kinematic_errors=ERRORS)
    env.reset(seed=3)
    return env


def test_without_errors_the_nominal_is_the_true(task_env):
    env = task_env("reach")
    env.reset(seed=3)
    loop, theatre = env.loop, env.loop.theatre
    np.testing.assert_array_equal(loop.tool.tip_in_world(), theatre.tip_in_world())
    np.testing.assert_array_equal(loop.scope.world_from_camera(), theatre.world_from_camera())
    np.testing.assert_array_equal(loop.tool.trocar_in_world, theatre.tool_arm.trocar_in_world)


def test_errors_of_the_expected_size_lie_between_nominal_and_true(erring):
    loop, theatre = erring.loop, erring.loop.theatre
    off_mm = np.linalg.norm(loop.tool.tip_in_world() - theatre.tip_in_world()) * 1e3
    # Six joints of 2 mrad at lever arms of 0.1 to 0.9 m, and 0.5 mm of the tip itself: some millimetres.
    assert 0.2 < off_mm < 8.0
    relative = np.linalg.inv(theatre.world_from_camera()) @ loop.scope.world_from_camera()
    assert 0.0 < np.linalg.norm(relative[:3, 3]) < 0.01
    assert 0.0 < np.arccos((np.trace(relative[:3, :3]) - 1.0) / 2.0) < 0.03


def test_docking_teaches_the_trocar_on_the_nominal_shaft_so_that_nothing_jumps(erring):
    loop, theatre = erring.loop, erring.loop.theatre
    nominal, true = loop.tool.model.world_from_shaft(loop.tool.home_q), theatre.world_from_shaft(theatre.tool_arm)
    as_taught = nominal[:3, :3].T @ (loop.tool.trocar_in_world - nominal[:3, 3])
    as_it_is = true[:3, :3].T @ (theatre.tool_arm.trocar_in_world - true[:3, 3])
    # The arm has held its posture for 40 ms since; 20 um are the servos' sag.
    np.testing.assert_allclose(as_taught, as_it_is, atol=2e-5)
    assert loop.max_rcm_error_m["tool"] < 1e-4


def test_a_nominal_tip_moves_as_commanded_in_the_nominal_cameras_frame(erring):
    before, _ = erring.reset(seed=3)
    for _ in range(25):
        after, *_, info = erring.step(np.array([0.0, 0.0, -0.02], np.float32))
    moved = after["tip_position"] - before["tip_position"]
    # 25 periods at 20 mm/s make 4 mm, less the start's acceleration and the servo's lag (below 0.5 mm).
    assert moved[2] == pytest.approx(-0.004, abs=5e-4)
    assert np.abs(moved[:2]).max() < 1e-4
    # The pivot is wrong by the errors, so that the true shaft leaves its trocar as it moves.
    assert 1e-4 < info["rcm_error_mm"]["tool"] < 1.0


def test_the_velocity_is_that_of_the_nominal_tip(erring):
    for _ in range(10):
        erring.step(np.array([0.02, 0.0, 0.0], np.float32))
    loop = erring.loop
    before = loop.tool.tip_in_world()
    speed = loop.tool.tip_velocity_in_world()
    erring.step(np.array([0.02, 0.0, 0.0], np.float32))
    # A tip at constant speed: the difference over a control period.
    np.testing.assert_allclose((loop.tool.tip_in_world() - before) / 0.008, speed, atol=1.5e-3)


def test_the_force_is_felt_along_the_axes_of_the_tip_and_reported_along_those_of_the_nominal_one(erring, monkeypatch):
    loop, theatre = erring.loop, erring.loop.theatre
    true_force = np.array([0.3, -0.4, 1.2])
    monkeypatch.setattr(theatre, "contact_force_in_world", lambda: true_force)
    nominal_q = theatre.joint_positions(theatre.tool_arm) - (theatre.tool_arm.home_q - loop.tool.home_q)
    felt = theatre.world_from_shaft(theatre.tool_arm)[:3, :3].T @ true_force
    expected = loop.tool.model.world_from_shaft(nominal_q)[:3, :3] @ felt
    np.testing.assert_allclose(loop.tool.contact_force_in_world(), expected, atol=1e-9)
    # Joints that are off by 2 mrad each turn 1.3 N by some millinewtons.
    assert np.linalg.norm(expected - true_force) > 1e-3


def test_errors_are_drawn_anew_with_every_seed_and_alike_with_the_same(erring):
    tips = []
    for seed in (3, 4, 3):
        erring.reset(seed=seed)
        tips.append(erring.loop.tool.home_q - erring.loop.theatre.tool_arm.home_q)
    np.testing.assert_allclose(tips[0], tips[2], atol=1e-15)
    assert np.abs(tips[0] - tips[1]).max() > 1e-4


def test_a_slow_robot_follows_late_and_tells_controllers_by_how_much(task_env):
    starts = {}
    for name in ("ideal", "ur5-cb"):
        env = task_env("reach", actuation=ActuationConfig.named(name))
        before, _ = env.reset(seed=3)
        begin_ns = env.loop.now_ns
        assert env.control_input().lead_ns == {"ideal": 0, "ur5-cb": 69_000_000}[name]
        for _ in range(30):
            after, *_, info = env.step(np.array([0.0, 0.0, -0.03], np.float32))
            if name not in starts and np.linalg.norm(after["tip_position"] - before["tip_position"]) > 2e-4:
                starts[name] = (env.loop.now_ns - begin_ns) * 1e-9
        assert info["rcm_error_mm"]["tool"] < 0.5
    # 35 ms of delay up to the next cycle of 8 ms, and part of the lag of 30 ms.
    assert 0.035 <= starts["ur5-cb"] - starts["ideal"] <= 0.075
