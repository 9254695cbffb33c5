"""What the tasks measure, and when they are solved."""

import numpy as np
import pytest

from laploop.envs.tasks.configs import PathChoiceConfig
from laploop.envs.tasks.scan import ScanEnv
from laploop.envs.theatre.organ_motion import BaseMotion, StageTravel
from laploop.envs.theatre.theatre import Theatre
from laploop.errors import InvalidValueError
from laploop.perception.geometry import invert_transform, transform_points

BREATHING = BaseMotion.named("breathing")


def test_tracking_splits_the_error_along_the_normal_of_the_moving_point(task_env):
    env = task_env("track")
    env.reset(seed=5)
    *_, info = env.step(np.zeros(3, np.float32))
    theatre = env.loop.theatre
    points = theatre.tissue.surface_points()
    target, normal = env.surface_target().position(points), env.surface_target().normal(points)
    # The stand-off of 3 mm and the ball's radius of 1.5 mm.
    error_mm = (theatre.tip_in_world() - target) * 1e3 - 4.5 * normal
    assert info["normal_error_mm"] == pytest.approx(error_mm @ normal)
    assert info["lateral_error_mm"] == pytest.approx(np.linalg.norm(np.cross(error_mm, normal)))
    assert info["target_error_mm"] == pytest.approx(np.hypot(info["normal_error_mm"], info["lateral_error_mm"]))


def test_tracking_counts_what_comes_after_the_settling_time_and_ends_with_its_time(task_env, run_task):
    env = task_env("track", motion=BREATHING, settle_s=1.4, max_seconds=1.8)
    infos = run_task(env, seed=3)
    counted = [info["normal_error_mm"] for info in infos if info["sim_s"] > 1.401]
    assert [info["assessed"] for info in infos].count(True) == len(counted) == 50
    assert env.metrics()["normal_rms_mm"] == pytest.approx(np.sqrt(np.mean(np.square(counted))))
    last = infos[-1]
    # With exact depth the scripted controller is far better than the 1 mm that a success allows.
    assert (last["terminated_by"], last["success"]) == ("time", True)
    assert last["reward_terms"]["success"] == 10.0
    assert not any(info["success"] for info in infos[:-1])


def test_an_idle_tip_does_not_track(task_env, run_task):
    class Idle:
        def reset(self):
            pass

        def command(self, state):
            return np.zeros(3)

    env = task_env("track", settle_s=0.1, max_seconds=0.2)
    last = run_task(env, seed=3, controller=Idle())[-1]
    assert (last["terminated_by"], last["success"]) == ("time", False)


def test_palpation_is_solved_by_holding_the_force_and_counts_only_near_the_target(task_env, run_task):
    env = task_env("palpate", success_hold_s=0.4, max_seconds=6.0)
    infos = run_task(env, seed=3)
    last = infos[-1]
    assert (last["terminated_by"], last["success"]) == ("success", True)
    # 0.4 s are 50 ticks, of which 95 %, so 48, must be in the band.
    assert last["held_share"] == pytest.approx(0.96)
    held = infos[-50:]
    assert sum(abs(info["mean_force_n"] - 0.5) <= 0.1 for info in held) == 48
    assert max(info["contact_force_n"] for info in infos) < 1.0
    assert not any(info["in_band"] for info in infos if info["target_error_mm"] > 5.0)
    assert last["reward_terms"]["band"] == 1.0


def test_a_force_in_the_band_does_not_count_far_from_the_target(task_env, monkeypatch):
    env = task_env("palpate")
    env.reset(seed=3)
    monkeypatch.setattr(Theatre, "contact_force_in_world", lambda _: np.array([0.0, 0.0, 0.5]))
    *_, info = env.step(np.zeros(3, np.float32))
    assert info["mean_force_n"] == pytest.approx(0.5)
    assert info["target_error_mm"] > 20.0
    assert not info["in_band"]
    _, normal, target = env.target_offset()
    # The ball's centre 4 mm beside an ideal touch is near enough.
    place = target + 0.0015 * normal + 0.004 * np.cross(normal, [0.0, 1.0, 0.0])
    monkeypatch.setattr(Theatre, "tip_in_world", lambda _: place)
    *_, info = env.step(np.zeros(3, np.float32))
    assert info["in_band"]


def test_palpation_ends_above_two_newtons(task_env):
    env = task_env("palpate", max_seconds=6.0)
    env.reset(seed=3)
    terminated = truncated = False
    while not (terminated or truncated):
        # Straight at the target, and through it.
        offset, normal, _ = env.target_offset()
        rotation = env.loop.theatre.world_from_camera()[:3, :3]
        way = -rotation.T @ (offset + 0.01 * normal)
        *_, terminated, truncated, info = env.step((0.05 * way / np.linalg.norm(way)).astype(np.float32))
    assert info["terminated_by"] == "force"
    assert 2.0 < info["contact_force_n"] < 8.0
    assert info["reward_terms"]["harm"] == -10.0


@pytest.mark.parametrize("changes", [{"force_n": 0.05}, {"force_n": 1.95}, {"hold_share": 1.5}, {"max_miss_m": 0.0}])
def test_palpation_of_an_impossible_force_is_refused(task_env, changes):
    with pytest.raises(InvalidValueError, match=next(iter(changes))):
        task_env("palpate", **changes)


def test_a_short_scan_is_followed_to_its_end(task_env, run_task):
    env = task_env("scan", path=PathChoiceConfig(length_m=0.012), max_seconds=8.0)
    infos = run_task(env, seed=4)
    last, metrics = infos[-1], env.metrics()
    assert (last["terminated_by"], last["success"]) == ("success", True)
    progress = np.array([info["path_progress"] for info in infos])
    assert progress[0] == 0.0
    assert progress[-1] == 1.0
    assert (np.diff(progress) >= 0.0).all()
    # The scan begins within 1.5 mm of its place, more along a curved path, and each step of 8 ms at 60 mm/s goes at most half a
    # millimetre.
    assert np.diff(progress).max() * metrics["path_length_mm"] < 2.5
    scanned = [info for info in infos if info["assessed"]]
    assert metrics["standoff_rms_mm"] == pytest.approx(np.sqrt(np.mean([info["standoff_error_mm"] ** 2 for info in scanned])))
    assert metrics["standoff_rms_mm"] < 1.0
    assert metrics["path_length_mm"] == pytest.approx(12.0, abs=0.5)
    assert sum(info["reward_terms"]["progress"] for info in infos) == pytest.approx(metrics["path_length_mm"], abs=0.6)


@pytest.mark.parametrize(
    ("aside_mm", "high_mm", "ended"), [(0.0, 0.0, "success"), (1.2, 0.0, "inaccurate"), (0.0, 1.2, "inaccurate")]
)
def test_a_scan_must_be_square_and_at_the_standoff(task_env, monkeypatch, aside_mm, high_mm, ended):
    env = task_env("scan")
    env.reset(seed=4)
    _, normal, foot = env.target_offset()
    across = np.cross(normal, [0.0, 1.0, 0.0])
    # The stand-off of 3 mm and the ball's radius; 1.2 mm aside are 15 degrees off the normal, of which 10 are allowed.
    place = foot + (0.0045 + 1e-3 * high_mm) * normal + 1e-3 * aside_mm * across / np.linalg.norm(across)
    monkeypatch.setattr(Theatre, "tip_in_world", lambda _: place)
    monkeypatch.setattr(ScanEnv, "_progress", lambda _: 1.0)
    *_, terminated, truncated, info = env.step(np.zeros(3, np.float32))
    assert (info["terminated_by"], info["success"]) == (ended, ended == "success")
    assert (terminated, truncated) == (True, False)


@pytest.mark.parametrize(("changes", "distance_m"), [({}, 0.080), ({"working_distance_m": 0.1}, 0.1)])
def test_a_scan_starts_at_the_distance_that_is_asked_for(task_env, changes, distance_m):
    env = task_env("scan", **changes)
    for seed in (3, 4):
        env.reset(seed=seed)
        assert env.loop.theatre.working_distance_m == distance_m


def test_a_path_can_be_drawn_by_hand(task_env):
    env = task_env("scan")
    corners = np.array([[100.0, 100.0], [150.0, 110.0], [140.0, 160.0]])
    observation, _ = env.reset(seed=3, options={"path_pixels": corners})
    path = observation["path_pixels"]
    np.testing.assert_allclose(path[[0, -1]], corners[[0, 2]], atol=1e-3)
    assert np.linalg.norm(path - corners[1], axis=1).min() < 3.0
    np.testing.assert_array_equal(observation["target_pixel"], path[0])
    # The foot before the start is the tissue that the first pixel showed.
    camera, theatre = env.loop.rig.camera, env.loop.theatre
    in_camera = transform_points(invert_transform(theatre.world_from_camera()), env.target_in_world())
    np.testing.assert_allclose(camera.project(in_camera), corners[0], atol=0.1)
    np.testing.assert_allclose(env.control_input().path_pixels, path, atol=1e-3)


@pytest.mark.parametrize("drawn", [[(100, 100)], [(100, 100), (300, 100)], [(1, 2, 3), (4, 5, 6)], [(1.0, np.nan), (2.0, 2.0)]])
def test_a_path_outside_the_frame_is_refused(task_env, drawn):
    with pytest.raises(InvalidValueError, match="path_pixels"):
        task_env("scan").reset(seed=3, options={"path_pixels": drawn})


def test_looking_measures_the_target_in_the_moving_camera(task_env):
    env = task_env("look")
    env.reset(seed=3)
    for _ in range(20):
        *_, info = env.step(np.array([0.01, 0.02, 0.03], np.float32))
    theatre, camera = env.loop.theatre, env.loop.rig.camera
    seen = transform_points(invert_transform(theatre.world_from_camera()), env.target_in_world())
    assert info["distance_error_mm"] == pytest.approx((seen[2] - 0.085) * 1e3)
    middle = np.array([camera.cx, camera.cy])
    assert info["centre_share"] == pytest.approx(np.linalg.norm(camera.project(seen) - middle) / camera.width)
    assert info["target_error_mm"] == pytest.approx(np.linalg.norm(seen - [0, 0, 0.085]) * 1e3)
    # The camera arm moves under its trocar, the tool arm not at all.
    assert 0.0 < info["rcm_error_mm"]["camera"] < 0.2
    assert info["rcm_error_mm"]["tool"] < 1e-3


def test_the_scope_goes_where_the_action_says(task_env):
    env = task_env("look")
    env.reset(seed=3)
    before = env.loop.theatre.world_from_camera()
    for _ in range(20):
        observation, *_ = env.step(np.array([0.0, 0.0, 0.02], np.float32))
    way = before[:3, :3].T @ (env.loop.theatre.world_from_camera()[:3, 3] - before[:3, 3])
    # 20 periods at 20 mm/s make 3.2 mm, less the start's acceleration and the servo's lag (below 0.5 mm).
    np.testing.assert_allclose(way, [0.0, 0.0, 0.0032], atol=5e-4)
    np.testing.assert_allclose(observation["scope_velocity"], [0.0, 0.0, 0.02], atol=1e-3)
    # From the trocar at 0.310 m to the tip at 0.200 m at the start.
    assert observation["scope_insertion"][0] == pytest.approx(0.110 + way[2], abs=1e-4)


def test_a_target_kept_in_the_middle_is_a_success(task_env, run_task):
    env = task_env("look", settle_s=1.2, max_seconds=1.7)
    last = run_task(env, seed=3)[-1]
    assert (last["terminated_by"], last["success"]) == ("time", True)
    assert env.metrics()["held_share"] == 1.0
    assert env.metrics()["centre_share_max"] <= 0.05


def test_the_marker_shows_where_the_target_was_when_the_frame_was_captured(task_env):
    env = task_env("look", travel=StageTravel(x_peak_to_peak_m=0.03, x_hz=0.3))
    observation, _ = env.reset(seed=3)
    np.testing.assert_allclose(observation["marker_pixel"], observation["target_pixel"], atol=1e-3)
    where = {}
    camera = env.loop.rig.camera
    for _ in range(20):
        theatre = env.loop.theatre
        seen = transform_points(invert_transform(theatre.world_from_camera()), env.target_in_world())
        where[theatre.now_ns] = camera.project(seen)
        env.step(np.zeros(3, np.float32))
    known = env.control_input()
    assert known.depth.captured_ns < known.now_ns - 30_000_000
    before, after = (where.get(known.depth.captured_ns + shift) for shift in (0, 8_000_000))
    expected = before if before is not None else after
    # At up to 14 mm/s the marker moves by 0.3 pixels in a control period.
    np.testing.assert_allclose(known.marker_pixel, expected, atol=0.5)
    assert np.linalg.norm(known.marker_pixel - known.target_pixel) > 1.0


def test_tasks_without_a_marker_do_not_tell_its_pixel(task_env):
    env = task_env("look", marker=False)
    observation, _ = env.reset(seed=3)
    assert env.control_input().marker_pixel is None
    np.testing.assert_array_equal(observation["marker_pixel"], [-1.0, -1.0])


def test_the_stage_travels_sideways_and_takes_the_tissue_along(task_env):
    travel = StageTravel(x_peak_to_peak_m=0.02, x_hz=0.5, y_peak_to_peak_m=0.01, y_hz=0.25)
    env = task_env("reach", travel=travel)
    env.reset(seed=3)
    start, begin_s = env.target_in_world(), env.loop.now_ns * 1e-9
    for _ in range(30):
        env.step(np.zeros(3, np.float32))
    moved = env.target_in_world() - start
    expected = travel.displacement(env.loop.now_ns * 1e-9) - travel.displacement(begin_s)
    # Soft tissue lags its stage by little: 31 mm/s set in at once, and its slowest mode is above 10 Hz.
    np.testing.assert_allclose(moved[:2], expected, atol=5e-4)
    assert np.abs(expected).min() > 0.001


def test_a_travel_that_is_too_wide_is_refused():
    with pytest.raises(InvalidValueError, match="x_peak_to_peak_m"):
        StageTravel(x_peak_to_peak_m=0.2)
    with pytest.raises(InvalidValueError, match="y_hz"):
        StageTravel(y_hz=0.0)
