"""What all tasks share: the order of a step, how an episode ends, what its reward is, and how a touch is measured."""

import numpy as np
import pytest

from laploop.assets.shafts import INSTRUMENT
from laploop.envs.loop.closed_loop import ClosedLoop
from laploop.envs.recording.recorder import NullRecorder
from laploop.envs.tasks.configs import ReachRewardWeights
from laploop.envs.tasks.reach import ReachEnv
from laploop.envs.theatre.theatre import Theatre
from laploop.errors import SimulationError

STILL = np.zeros(3, np.float32)


def watch(monkeypatch, kind, method, seen):
    """Call `seen(self, ...)` before a method of a class runs."""
    original = getattr(kind, method)

    def wrapped(self, *arguments, **named):
        seen(self, *arguments, **named)
        return original(self, *arguments, **named)

    monkeypatch.setattr(kind, method, wrapped)


def press(env, arm, newtons):
    """Push an arm's wrist sideways from now on; the trocar itself pushes the link behind, so that this is a link before."""
    theatre = env.loop.theatre
    theatre.data.xfrc_applied[theatre.model.body(f"{arm.name}/wrist_3_link").id, 1] = newtons


def test_a_step_is_the_loop_then_measurement_then_end_then_reward_then_record(task_env, monkeypatch):
    env = task_env("reach")
    env.reset(seed=3)
    events = []
    for kind, method in (
        (ClosedLoop, "advancing"),
        (ReachEnv, "measure"),
        (ReachEnv, "ended_by"),
        (ReachEnv, "reward_terms"),
        (NullRecorder, "tick"),
    ):
        watch(monkeypatch, kind, method, lambda *_, name=method, **__: events.append(name))
    env.step(STILL)
    assert events == ["advancing", "measure", "ended_by", "reward_terms", "tick"]


def test_a_reset_chooses_the_target_in_the_first_frame_and_measures_when_depth_has_arrived(task_env, monkeypatch):
    events = []
    watch(monkeypatch, ReachEnv, "choose_target", lambda env, *_: events.append(("target", env.loop.now_ns)))
    watch(monkeypatch, ReachEnv, "measure", lambda env, *, begin: events.append((begin, env.loop.now_ns)))
    env = task_env("reach")
    _, info = env.reset(seed=3)
    assert events == [("target", 0), (True, 40_000_000)]
    assert (info["terminated_by"], info["success"], info["reward_terms"]) == (None, False, {})


def test_the_reward_is_the_sum_of_the_weighted_terms_of_the_task_and_of_those_that_all_share(task_env, monkeypatch):
    monkeypatch.setattr(ReachEnv, "reward_terms", lambda _: {"distance": -0.5, "progress": 0.25})
    monkeypatch.setattr(Theatre, "contact_force_in_world", lambda _: np.array([0.0, 0.0, 3.0]))
    env = task_env("reach", rewards=ReachRewardWeights(distance=2.0))
    env.reset(seed=3)
    _, reward, *_, info = env.step(STILL)
    # 1 N above the alarm, weighted by a half.
    assert info["reward_terms"] == {
        "distance": -1.0,
        "progress": 5.0,
        "force": -0.5,
        "effort": 0.0,
        "success": 0.0,
        "harm": 0.0,
    }
    assert reward == pytest.approx(3.5)


def test_the_effort_is_the_square_of_the_commanded_speed_over_the_largest(task_env):
    env = task_env("reach")
    env.reset(seed=3)
    *_, info = env.step(np.array([0.03, 0.0, -0.04], np.float32))
    # Speeds in m/s; the weight is 0.02.
    assert info["reward_terms"]["effort"] == pytest.approx(-0.02 * (0.05 / 0.06) ** 2)


def test_time_truncates_and_does_not_terminate(task_env):
    env = task_env("reach", max_seconds=0.056)
    env.reset(seed=3)
    *_, terminated, truncated, info = env.step(STILL)
    assert (terminated, truncated, info["terminated_by"]) == (False, False, None)
    *_, terminated, truncated, info = env.step(STILL)
    assert (terminated, truncated, info["terminated_by"], info["success"]) == (False, True, "time", False)


@pytest.mark.parametrize(("reason", "success"), [("success", True), ("something else", False)])
def test_an_end_in_the_last_tick_terminates_and_does_not_truncate(task_env, monkeypatch, reason, success):
    monkeypatch.setattr(ReachEnv, "ended_by", lambda _: reason)
    env = task_env("reach", max_seconds=0.048)
    env.reset(seed=3)
    *_, terminated, truncated, info = env.step(STILL)
    assert (terminated, truncated, info["terminated_by"], info["success"]) == (True, False, reason, success)
    with pytest.raises(SimulationError, match="call reset"):
        env.step(STILL)


def test_harm_done_in_the_tick_of_success_is_no_success(task_env, monkeypatch):
    monkeypatch.setattr(ReachEnv, "ended_by", lambda _: "success")
    monkeypatch.setattr(Theatre, "contact_force_in_world", lambda _: np.array([0.0, 0.0, 6.0]))
    env = task_env("reach")
    env.reset(seed=3)
    *_, terminated, truncated, info = env.step(STILL)
    assert (terminated, truncated, info["terminated_by"], info["success"]) == (True, False, "force", False)
    assert info["reward_terms"]["harm"] == -10.0
    assert info["reward_terms"]["success"] == 0.0


@pytest.mark.parametrize("pushed", ["tool", "camera"])
def test_an_episode_ends_when_either_shaft_is_pushed_off_its_trocar(task_env, pushed):
    env = task_env("reach")
    env.reset(seed=3)
    theatre = env.loop.theatre
    arm = {"tool": theatre.tool_arm, "camera": theatre.camera_arm}[pushed]
    # The servos and the wall bear 100 N with some tenths of a millimetre.
    press(env, arm, 100.0)
    for _ in range(10):
        *_, terminated, truncated, info = env.step(STILL)
        assert not terminated
    assert 0.1 < info["rcm_error_mm"][pushed] < 5.0
    press(env, arm, 1000.0)
    infos = []
    while not terminated and len(infos) < 10:
        *_, terminated, truncated, info = env.step(STILL)
        infos.append(info)
    assert (info["terminated_by"], terminated, truncated, info["success"]) == ("rcm", True, False, False)
    assert info["reward_terms"]["harm"] == -10.0
    errors = [info["rcm_error_mm"][pushed] for info in infos]
    assert max(errors[:-1], default=0.0) <= 5.0 < errors[-1]
    # The other arm feels nothing of it.
    (other,) = {"tool", "camera"} - {pushed}
    assert info["rcm_error_mm"][other] < 1e-3


def test_an_episode_that_has_not_begun_or_was_closed_does_not_go_on(task_env):
    env = task_env("reach")
    with pytest.raises(SimulationError, match="call reset"):
        env.step(STILL)
    with pytest.raises(SimulationError, match="no target"):
        env.target_in_world()
    env.reset(seed=3)
    env.close()
    with pytest.raises(SimulationError, match="call reset"):
        env.step(STILL)


def test_the_ball_of_the_tip_touches_the_target_at_an_error_of_zero(task_env, monkeypatch):
    env = task_env("reach")
    env.reset(seed=3)
    points = env.loop.theatre.tissue.surface_points()
    target, normal = env.surface_target().position(points), env.surface_target().normal(points)
    across = np.cross(normal, [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    radius = INSTRUMENT.tip_radius_m
    assert radius == 0.0015
    for place, expected_mm in (
        (target + radius * normal, 0.0),
        (target, 1.5),
        (target - 0.001 * normal, 2.5),
        (target + (radius + 0.003) * normal, 3.0),
        (target + (radius + 0.003) * normal + 0.004 * across, 5.0),
    ):
        monkeypatch.setattr(Theatre, "tip_in_world", lambda _, place=place: place)
        # Millimetres, rounding alone.
        assert env.touch_error_mm() == pytest.approx(expected_mm, abs=1e-9)


def test_the_normal_of_the_target_points_out_of_the_tissue(task_env):
    env = task_env("reach")
    for seed in (3, 4):
        env.reset(seed=seed)
        _, normal, target = env.target_offset()
        assert np.linalg.norm(normal) == pytest.approx(1.0)
        to_camera = env.loop.theatre.world_from_camera()[:3, 3] - target
        assert normal @ to_camera / np.linalg.norm(to_camera) > 0.3


def test_the_state_shows_target_and_normal_in_the_cameras_frame(task_env):
    env = task_env("reach", observation_mode="state")
    observation, _ = env.reset(seed=3, options={"target_pixel": (120, 140)})
    captured = env.loop.first_captured
    expected = env.loop.rig.camera.unproject(np.array([120.5, 140.5]), captured.truth.depth_mm[140, 120] * 1e-3)
    # Metres: still tissue, seen by a camera that stands still, to the precision of float32.
    np.testing.assert_allclose(observation["target_position"], expected, atol=2e-6)
    # The camera looks along +z, at tissue that faces it.
    assert observation["target_normal"][2] < -0.3
    seen = captured.truth.normals[140, 120]
    assert observation["target_normal"] @ seen / np.linalg.norm(seen) > 0.9
