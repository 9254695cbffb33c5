"""What actions mean, and what happens to those that mean nothing."""

import numpy as np
import pytest

from laploop.control.controllers.registry import make_controller
from laploop.envs.tasks.actions import action_bound
from laploop.envs.theatre.theatre import Theatre
from laploop.errors import InvalidValueError
from laploop.perception.messages import DepthEstimate

PERIOD_S = 0.008


def moved(env, action, steps):
    """Return how far the tool's tip went, (3,), along the camera's axes, and the worst trocar error in mm."""
    before, _ = env.reset(seed=7)
    errors = []
    for _ in range(steps):
        after, *_, info = env.step(action)
        errors.append(max(info["rcm_error_mm"].values()))
    return after["tip_position"] - before["tip_position"], max(errors)


def test_an_offset_a_period_is_a_velocity(task_env):
    velocity = np.array([-0.02, 0.01, -0.02], np.float32)
    one, _ = moved(task_env("reach"), velocity, 12)
    other, _ = moved(task_env("reach", action_mode="tip-offset"), (velocity * PERIOD_S).astype(np.float32), 12)
    # The same command but for the rounding of float32, 1e-7 of it.
    np.testing.assert_allclose(one, other, atol=1e-7)
    assert np.linalg.norm(one) > 0.002


def test_joint_velocities_move_the_tip_and_leave_the_shaft_on_its_trocar(task_env):
    env = task_env("reach", action_mode="joint-velocity")
    way, rcm_mm = moved(env, np.array([0.05, -0.1, 0.1, 0.05, -0.05, 0.1], np.float32), 25)
    assert np.linalg.norm(way) > 0.001
    # As in the other modes: the promise of the closed loop with ideal actuation.
    assert rcm_mm < 0.2


def test_joint_velocities_that_respect_the_trocar_are_not_changed(task_env):
    env = task_env("reach", action_mode="joint-velocity")
    env.reset(seed=7)
    loop, arm = env.loop, env.loop.tool
    q = loop._tool_controller.q
    step = 1e-6
    # Two neighbouring postures of the inverse kinematics have the trocar in common.
    start, qdot = loop._tool_controller.step(np.array([0.0, 0.0, 0.001]), PERIOD_S)
    wanted = (arm.model.tip_in_world(start + step * qdot) - arm.model.tip_in_world(start)) / step
    np.testing.assert_allclose(arm.tip_velocity_of_joints(q, qdot), wanted, atol=2e-5)


def test_a_residual_of_zero_is_the_scripted_controller(task_env):
    scripted, residual = task_env("reach"), task_env("reach", action_mode="residual")
    controller = make_controller("reach", scripted.loop.rig)
    controller.reset()
    one, _ = scripted.reset(seed=7)
    other, _ = residual.reset(seed=7)
    for _ in range(15):
        # In float64, as the residual is added to it.
        one, *_ = scripted.step(controller.command(scripted.control_input()))
        other, *_ = residual.step(np.zeros(3, np.float32))
        np.testing.assert_array_equal(one["tip_position"], other["tip_position"])


def test_depth_that_jumps_is_told():
    from laploop.envs.tasks.configs import ReachConfig
    from laploop.envs.tasks.reach import ReachEnv

    class Slipping:
        """A wall that comes out a stripe too far away from the third frame on."""

        frames = 0

        def estimate(self, image):
            self.frames += 1
            depth_mm = np.full(image.shape, 90.0 if self.frames < 3 else 110.0, dtype=np.float32)
            return DepthEstimate(depth_mm=depth_mm, valid=np.ones(image.shape, dtype=bool))

    env = ReachEnv(ReachConfig(action_mode="residual"), perception=Slipping())
    told = [env.reset(seed=0)[1]["depth_jump_fraction"]]
    told += [env.step(np.zeros(3, np.float32))[4]["depth_jump_fraction"] for _ in range(30)]
    env.close()
    assert told[:5] == [0.0] * 5
    assert told[-1] > 0.9
    plain = ReachEnv(ReachConfig(), perception="oracle")
    assert plain.reset(seed=0)[1]["depth_jump_fraction"] is None
    plain.close()


def test_a_residual_adds_to_a_users_own_controller():
    from laploop.envs.tasks.configs import ReachConfig
    from laploop.envs.tasks.reach import ReachEnv

    class Up:
        def reset(self):
            pass

        def command(self, state):
            return np.array([0.0, 0.0, -0.02])

    env = ReachEnv(ReachConfig(action_mode="residual"), perception="oracle", controller=Up())
    before, _ = env.reset(seed=7)
    for _ in range(15):
        after, *_ = env.step(np.array([0.02, 0.0, 0.0], np.float32))
    env.close()
    way = after["tip_position"] - before["tip_position"]
    # 15 periods at 20 mm/s make 2.4 mm, less the start's acceleration and the servo's lag (below 0.5 mm).
    np.testing.assert_allclose(way, [0.0024, 0.0, -0.0024], atol=5e-4)


@pytest.mark.parametrize("mode", ["tip-velocity", "tip-offset", "joint-velocity", "residual"])
def test_larger_actions_are_clipped(task_env, mode):
    env = task_env("reach", action_mode=mode)
    bound = action_bound(env.config)
    size = env.action_space.shape[0]
    assert env.action_space.high[0] == np.float32(bound)
    one, _ = moved(env, np.full(size, bound), 3)
    other, _ = moved(env, np.full(size, 100.0 * bound), 3)
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("action", [np.zeros(4), np.zeros((3, 1)), "up", None])
def test_actions_of_another_shape_are_refused_even_where_the_arm_would_hold(task_env, action):
    env = task_env("reach", bad_action="hold")
    env.reset(seed=7)
    with pytest.raises(InvalidValueError, match="action"):
        env.step(action)


def test_an_action_that_is_not_finite_is_an_error_or_a_hold(task_env):
    env = task_env("reach")
    env.reset(seed=7)
    with pytest.raises(InvalidValueError, match="3 finite numbers"):
        env.step(np.array([0.0, np.nan, 0.0]))
    env = task_env("reach", bad_action="hold")
    before, _ = env.reset(seed=7)
    for _ in range(5):
        after, *_, info = env.step(np.array([0.0, np.nan, np.inf]))
        assert info["fault"] == "action_not_finite"
    # At rest it stays at rest; 1 um is the servos' sag.
    assert np.abs(after["tip_position"] - before["tip_position"]).max() < 1e-6
    *_, info = env.step(np.zeros(3))
    assert info["fault"] is None


@pytest.mark.parametrize(("force_n", "out_mm"), [(0.6, 0.0), (0.8, 2.4)])
def test_a_tip_that_nobody_commands_withdraws_along_its_shaft_from_what_presses_on_it(task_env, monkeypatch, force_n, out_mm):
    env = task_env("reach", bad_action="hold")
    env.reset(seed=7)
    monkeypatch.setattr(Theatre, "contact_force_in_world", lambda _: np.array([0.0, 0.0, force_n]))
    start, axis = env.loop.theatre.tip_in_world(), env.loop.tool.shaft_axis_in_world()
    for _ in range(10):
        env.step(np.full(3, np.nan))
    way_mm = 1e3 * (env.loop.theatre.tip_in_world() - start)
    # 10 periods at 30 mm/s, less the start's acceleration and the servo's lag (below 0.8 mm); the axis points inwards.
    assert -way_mm @ axis == pytest.approx(out_mm, abs=0.8 if out_mm else 1e-3)
    assert np.linalg.norm(way_mm - (way_mm @ axis) * axis) < 0.05


def test_a_controller_that_fails_inside_the_residual_mode_makes_the_arm_hold():
    from laploop.envs.tasks.configs import ReachConfig
    from laploop.envs.tasks.reach import ReachEnv

    class Broken:
        def reset(self):
            pass

        def command(self, state):
            return np.array([np.nan, 0.0, 0.0])

    env = ReachEnv(ReachConfig(action_mode="residual"), perception="oracle", controller=Broken())
    before, _ = env.reset(seed=7)
    after, *_, info = env.step(np.full(3, 0.05, np.float32))
    env.close()
    assert info["fault"] == "controller_not_finite"
    assert np.abs(after["tip_position"] - before["tip_position"]).max() < 1e-6


def test_every_episode_begins_with_a_controller_that_was_reset():
    from laploop.envs.tasks.configs import ReachConfig
    from laploop.envs.tasks.reach import ReachEnv

    class Counting:
        resets = 0

        def reset(self):
            self.resets += 1

        def command(self, state):
            return np.zeros(3)

    controller = Counting()
    env = ReachEnv(ReachConfig(action_mode="residual"), perception="oracle", controller=controller)
    for expected in (1, 2):
        env.reset(seed=3)
        assert controller.resets == expected
    env.close()
