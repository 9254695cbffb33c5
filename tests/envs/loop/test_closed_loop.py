"""The order of a step, the arrival of frames and their ages, in a whole loop with exact depth."""

import threading
from itertools import pairwise

import mujoco
import numpy as np
import pytest

from laploop.envs.loop import closed_loop
from laploop.envs.loop.faults import Fault
from laploop.envs.loop.kinematic_errors import KinematicErrors
from laploop.envs.loop.perception_server import PerceptionServer
from laploop.envs.loop.proprioception import Proprioception
from laploop.envs.loop.timing.config import TimingConfig
from laploop.envs.loop.timing.latency import ConstantLatency, TraceLatency
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.envs.tasks.reach import ReachEnv
from laploop.envs.theatre.actuation import ActuationConfig
from laploop.envs.theatre.step_log import StepLog
from laploop.envs.theatre.theatre import Theatre
from laploop.envs.theatre.trocar import TrocarConfig
from laploop.errors import SimulationError
from laploop.perception.geometry import invert_transform, transform_points

MS = 1_000_000
STILL = np.zeros(3)


def watch(monkeypatch, kind, method, seen):
    """Call `seen(self)` before a method of a class runs."""
    original = getattr(kind, method)

    def wrapped(self, *arguments, **named):
        seen(self)
        return original(self, *arguments, **named)

    monkeypatch.setattr(kind, method, wrapped)


def test_a_step_is_physics_then_proprioception_then_capture_then_arrival(task_env, monkeypatch):
    # A camera period of 2.5 control periods: every other frame is captured in the middle of one.
    env = task_env("reach", camera_hz=50.0)
    env.reset(seed=3)
    events = []
    for kind, method, name in (
        (Theatre, "set_joint_targets", "command"),
        (Theatre, "stepping", "physics"),
        (Proprioception, "after_physics_step", "proprioception"),
        (StripeCamera, "snapshot", "capture"),
        (PerceptionServer, "poll", "arrival"),
    ):
        watch(monkeypatch, kind, method, lambda _, name=name: events.append(name))
    begin_ns = env.loop.now_ns
    for _ in range(5):
        env.loop.advance(STILL)
    expected = []
    for step in range(1, 21):
        due = (begin_ns + step * 2 * MS) % (20 * MS) == 0
        expected += ["command"] if step % 4 == 1 else []
        expected += ["physics", "proprioception"] + ["capture"] * due + ["arrival"]
    assert events == expected
    assert events.count("capture") == 2


def test_a_frame_shows_the_theatre_as_it_is_and_not_a_step_before(task_env, monkeypatch):
    env = task_env("look", camera_hz=50.0)
    env.reset(seed=3)
    lags = []

    def compare(camera):
        theatre = env.loop.theatre
        fresh = mujoco.MjData(theatre.model)
        mujoco.mj_copyData(fresh, theatre.model, theatre.data)
        mujoco.mj_forward(theatre.model, fresh)
        lags.append(np.abs(fresh.site_xpos - theatre.data.site_xpos).max())

    watch(monkeypatch, StripeCamera, "snapshot", compare)
    for _ in range(10):
        env.step(np.array([0.0, 0.0, 0.03], np.float32))
    assert len(lags) == 4
    # Metres. A step of 2 ms at 30 mm/s would show as 60 um.
    assert max(lags) < 1e-12


def test_frames_are_captured_once_a_camera_period_and_carry_the_pose_of_that_time(task_env):
    env = task_env("look")
    env.reset(seed=3)
    loop, poses, served = env.loop, {}, []
    for _ in range(15):
        served += loop.advance(STILL, np.array([0.01, 0.0, 0.02]))
        poses[loop.now_ns] = loop.theatre.world_from_camera()
    assert loop.frame_count == 1 + loop.now_ns // (40 * MS) == 5
    assert [one.depth.captured_ns for one in served] == [40 * MS, 80 * MS, 120 * MS]
    for one in served[1:]:
        np.testing.assert_array_equal(one.depth.world_from_camera, poses[one.depth.captured_ns])
    assert np.linalg.norm(served[2].depth.world_from_camera - served[1].depth.world_from_camera) > 5e-4


def test_depth_ages_until_the_next_frame_has_been_transferred_and_served(task_env):
    env = task_env(
        "reach", timing=TimingConfig(service=ConstantLatency(latency_ms=36.0), transfer=ConstantLatency(latency_ms=12.0))
    )
    _, info = env.reset(seed=3)
    # The frame of time 0 is there at 12 + 36 = 48 ms, at the end of a control period, and seen in it.
    assert (info["sim_s"], info["depth_age_ms"]) == (0.048, 48.0)
    ages = [env.step(STILL)[-1]["depth_age_ms"] for _ in range(10)]
    # The next, of 40 ms, comes at 88 ms, again at the end of a period.
    assert ages == [56.0, 64.0, 72.0, 80.0, 48.0, 56.0, 64.0, 72.0, 80.0, 48.0]


def test_a_frame_that_is_ready_after_a_control_tick_waits_for_the_next(task_env):
    env = task_env("reach", timing=TimingConfig(service=ConstantLatency(latency_ms=48.000001)))
    _, info = env.reset(seed=3)
    # A nanosecond too late for the tick at 48 ms.
    assert (info["sim_s"], info["depth_age_ms"]) == (0.056, 56.0)


def test_before_the_first_frame_has_arrived_there_is_none(task_env, monkeypatch):
    known = []
    watch(monkeypatch, ReachEnv, "choose_target", lambda env: known.append(env.loop.control_input(np.zeros(2))))
    env = task_env("reach")
    env.reset(seed=3)
    assert [(one.now_ns, one.depth) for one in known] == [(0, None)]
    assert env.control_input().depth is not None


def test_a_reset_does_not_wait_for_the_estimate_of_the_episode_before(task_env, monkeypatch):
    started, release, order = threading.Event(), threading.Event(), []
    env = task_env("reach")
    env.reset(seed=3)
    # As the frame at the end of a reset may be when the next one begins.
    env.loop._server._thread.later(lambda: (started.set(), release.wait(5.0), order.append("estimated"))).begin()
    assert started.wait(5.0)

    def chosen(_env):
        order.append("target chosen")
        release.set()

    watch(monkeypatch, ReachEnv, "choose_target", chosen)
    env.reset(seed=3)
    assert order == ["target chosen", "estimated"]


def test_a_slow_perception_serves_the_newest_frame_and_drops_those_it_overtook(task_env):
    env = task_env("reach", timing=TimingConfig(service=ConstantLatency(latency_ms=100.0)))
    env.reset(seed=3)
    loop, served = env.loop, [env.loop.newest_served]
    for _ in range(40):
        served += loop.advance(STILL)
    # Served one after the other, each the newest when its turn comes: at 100 ms the frame of 80, at 200 that of 200 itself.
    assert [one.depth.captured_ns // MS for one in served] == [0, 80, 200, 280]
    assert [one.depth.available_ns // MS for one in served] == [100, 200, 300, 400]
    # Of eleven frames until 400 ms four have arrived and the last is being served.
    assert loop.frame_count == 11
    assert loop.dropped_frames == 6
    assert loop.newest_served is served[-1]


def test_a_frame_that_arrives_after_a_newer_one_is_dropped(task_env):
    fault = Fault(kind="late-frame", start_s=0.08, end_s=0.2)
    env = task_env("reach", faults=(fault,))
    env.reset(seed=3)
    loop, served = env.loop, [env.loop.newest_served]
    for _ in range(25):
        served += loop.advance(STILL)
        assert loop.newest_served is served[-1]
    # The frame of 80 ms comes at 200 ms, when that of 160 ms is there.
    assert [one.depth.captured_ns // MS for one in served] == [0, 40, 120, 160, 200]
    assert loop.dropped_frames == 1


def test_the_force_of_a_period_is_the_worst_and_the_mean_of_its_steps(task_env, monkeypatch):
    env = task_env("reach")
    env.reset(seed=3)
    newtons = iter([1.0, 4.0, 2.0, 3.0, 0.5, 0.5, 0.5, 0.5])
    force = [0.0]
    watch(monkeypatch, Theatre, "stepping", lambda _: force.__setitem__(0, next(newtons)))
    monkeypatch.setattr(Theatre, "contact_force_in_world", lambda _: np.array([0.0, 0.6, -0.8]) * force[0])
    env.loop.advance(STILL)
    assert (env.loop.max_force_n, env.loop.mean_force_n) == pytest.approx((4.0, 2.5))
    env.loop.advance(STILL)
    assert (env.loop.max_force_n, env.loop.mean_force_n) == pytest.approx((0.5, 0.5))


def test_the_trocar_errors_of_a_period_are_the_worst_of_its_steps(task_env, monkeypatch):
    env = task_env("reach")
    env.reset(seed=3)
    # Metres, a row a physics step: camera arm and tool arm.
    errors = np.array([[1e-4, 5e-4], [3e-4, 1e-4], [2e-4, 1e-4], [0.0, 1e-4]])
    monkeypatch.setattr(StepLog, "rcm_error_m", errors)
    *_, info = env.step(STILL)
    assert info["rcm_error_mm"] == pytest.approx({"camera": 0.3, "tool": 0.5})


def test_a_controller_feels_the_force_along_the_axes_of_the_camera_that_it_believes_in(task_env, monkeypatch):
    env = task_env("reach", kinematic_errors=KinematicErrors(hand_eye_rad=0.1))
    env.reset(seed=3)
    down = np.array([0.0, 0.0, -10.0])
    monkeypatch.setattr(Theatre, "contact_force_in_world", lambda _: down)
    for _ in range(3):
        env.loop.advance(STILL)
    known = env.control_input()
    nominal, true = env.loop.scope.world_from_camera(), env.loop.theatre.world_from_camera()
    np.testing.assert_allclose(known.contact_force_in_camera, nominal[:3, :3].T @ down, atol=1e-9)
    np.testing.assert_allclose(known.world_from_camera, nominal, atol=1e-12)
    # The two cameras are turned by about 0.17 rad, root sum square of three axes; 10 N then differ by a newton or more.
    assert np.linalg.norm(known.contact_force_in_camera - true[:3, :3].T @ down) > 0.5
    assert known.contact_force_n == pytest.approx(10.0)
    # What is observed is what controllers know; newtons in single precision.
    observation, *_ = env.step(STILL)
    np.testing.assert_allclose(observation["contact_force"], nominal[:3, :3].T @ down, atol=1e-5)


def test_all_that_a_controller_knows_comes_from_the_kinematics_that_it_believes_in(task_env):
    errors = KinematicErrors(joint_rad=2e-3, tip_m=5e-4, hand_eye_m=1e-3, hand_eye_rad=0.02)
    env = task_env("reach", kinematic_errors=errors)
    env.reset(seed=3)
    for _ in range(6):
        env.step(np.array([0.02, 0.0, -0.02], np.float32))
    known, loop = env.control_input(), env.loop
    camera_from_world = invert_transform(loop.scope.world_from_camera())
    rotation = camera_from_world[:3, :3]
    for value, expected in (
        (known.tip_in_camera, transform_points(camera_from_world, loop.tool.tip_in_world())),
        (known.tip_velocity_in_camera, rotation @ loop.tool.tip_velocity_in_world()),
        (known.trocar_in_camera, transform_points(camera_from_world, loop.tool.trocar_in_world)),
        (known.shaft_axis_in_camera, rotation @ loop.tool.shaft_axis_in_world()),
        (known.scope_trocar_in_camera, transform_points(camera_from_world, loop.scope.trocar_in_world)),
        # The scope stands still, so that the pose at the capture is the present one.
        (known.depth.world_from_camera, loop.scope.world_from_camera()),
    ):
        np.testing.assert_allclose(value, expected, atol=1e-6)
    truth = invert_transform(loop.theatre.world_from_camera())
    # Metres: hand-eye and joints make millimetres at the tip, which nothing that is known may show.
    assert np.linalg.norm(known.tip_in_camera - transform_points(truth, loop.theatre.tip_in_world())) > 5e-4
    observation = env.step(np.zeros(3, np.float32))[0]
    np.testing.assert_allclose(observation["tip_position"], env.control_input().tip_in_camera, atol=1e-6)


def test_each_moved_shaft_is_told_where_the_other_is(task_env):
    for task in ("reach", "look"):
        env = task_env(task)
        env.reset(seed=3)
        env.step(STILL)
        controller = env.loop._scope_controller if env.moves_scope else env.loop._tool_controller
        # Metres: the arms are at rest, so that what the controller keeps clear of is what the monitor sees.
        assert controller.shaft_clearance_m == pytest.approx(1e-3 * env.loop.watch.worst.shaft_room_mm, abs=1e-5)


def test_time_runs_in_whole_control_periods(task_env):
    env = task_env("reach")
    env.reset(seed=3)
    times = [env.loop.now_ns]
    for _ in range(6):
        env.loop.advance(STILL)
        times.append(env.loop.now_ns)
    assert {later - earlier for earlier, later in pairwise(times)} == {8 * MS}


def test_a_perception_that_never_answers_is_an_error(task_env, monkeypatch):
    monkeypatch.setattr(closed_loop, "MAX_WAIT_NS", 60 * MS)
    env = task_env("reach", timing=TimingConfig(service=ConstantLatency(latency_ms=200.0)))
    with pytest.raises(SimulationError, match="no depth frame arrived"):
        env.reset(seed=3)


def test_a_closed_loop_that_was_closed_does_not_go_on(task_env):
    env = task_env("reach")
    env.reset(seed=3)
    env.loop.close()
    with pytest.raises(SimulationError, match="no episode is running"):
        env.loop.advance(STILL)


def test_the_theatre_is_the_one_of_the_loops_configuration(task_env):
    env = task_env("reach", actuation=ActuationConfig.named("ur5-cb"), trocar=TrocarConfig.named("none"))
    env.reset(seed=3)
    assert env.loop.theatre.config is env.loop.config.theatre
    # 35 ms of delay, 30 of lag and half a cycle of 8 ms: what controllers are given is what the arms do.
    assert env.control_input().lead_ns == 69_000_000
    assert not env.loop.theatre.config.trocar.acts
    for _ in range(5):
        *_, info = env.step(np.array([0.0, 0.0, -0.02], np.float32))
    assert info["port_force_n"] == {"camera": 0.0, "tool": 0.0}


def test_two_loops_of_one_configuration_do_not_share_their_place_in_a_trace(task_env):
    trace = TraceLatency(latencies_ms=(40.0, 80.0, 120.0))
    one, other = (task_env("reach", timing=TimingConfig(service=trace)) for _ in range(2))
    ages = []
    for env in (one, other, one):
        _, info = env.reset(seed=3)
        ages.append(info["depth_age_ms"])
        env.step(STILL)
    # Each episode begins with the first recorded time.
    assert ages == [40.0, 40.0, 40.0]
