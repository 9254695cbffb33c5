"""Faults: what each does to the sensors, and how the loop and the scripted controllers bear it."""

from dataclasses import replace
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.envs.loop.faults import OUT_OF_REACH, Fault, FaultInjector, FaultKind
from laploop.envs.loop.perception_server import ServedFrame
from laploop.envs.loop.proprioception import ProprioceptiveReading
from laploop.envs.theatre.organ_motion import BaseMotion
from laploop.errors import InvalidValueError, UnknownNameError
from laploop.perception.geometry import Rig
from laploop.perception.messages import DepthEstimate

CAMERA = Rig.from_optics(ScopeOptics()).camera

CONTACT_S = 1.8
"""The palpating tip of seed 3 touches before that."""


def frame(index, marker_pixel=None):
    """Make a depth frame of 25 a second that arrives 40 ms after its capture."""
    estimate = DepthEstimate(depth_mm=np.full((20, 30), 90.0, np.float32), valid=np.ones((20, 30), bool))
    captured_ns = index * 40_000_000
    captured = SimpleNamespace(
        index=index,
        captured_ns=captured_ns,
        time_stamp_ns=captured_ns,
        world_from_camera=np.eye(4),
        marker_pixel=lambda _: marker_pixel,
    )
    pending = SimpleNamespace(wait=lambda: estimate)
    return ServedFrame(captured=captured, available_ns=captured_ns + 40_000_000, estimate=pending)


def stream(fault, frames=8, marker_pixel=None):
    """Return (time of arrival in units of frames, frame) of all that arrive."""
    injector = FaultInjector((fault,))
    return [
        (now, one)
        for now in range(1, frames)
        for one in injector.depth_frames([frame(now - 1, marker_pixel)], CAMERA, now * 40_000_000)
    ]


def test_frames_of_the_time_in_which_perception_stops_never_arrive():
    arrived = stream(Fault(kind="perception-stops", start_s=0.08, end_s=0.16))
    assert [one.depth.index for _, one in arrived] == [0, 1, 4, 5, 6]


def test_one_frame_alone_jumps():
    arrived = stream(Fault(kind="depth-jump", start_s=0.08, end_s=0.2, jump_m=0.02))
    assert [float(one.depth.estimate.depth_mm[0, 0]) for _, one in arrived] == [90, 90, 110, 90, 90, 90, 90]


def test_invalid_frames_arrive_and_say_so():
    arrived = stream(Fault(kind="depth-invalid", start_s=0.08, end_s=0.16))
    assert [bool(one.depth.estimate.valid.any()) for _, one in arrived] == [True, True, False, False, True, True, True]


def test_a_late_frame_comes_after_newer_ones():
    arrived = stream(Fault(kind="late-frame", start_s=0.08, end_s=0.2))
    assert [one.depth.index for _, one in arrived] == [0, 1, 3, 4, 2, 5, 6]
    late = arrived[4][1].depth
    assert (late.captured_ns, late.available_ns) == (80_000_000, 200_000_000)


def test_a_hidden_target_takes_its_surroundings_and_its_marker_away():
    fault = Fault(kind="target-hidden", start_s=0.08, end_s=0.12, radius_px=3.0)
    arrived = [one for _, one in stream(fault, marker_pixel=np.array([10.5, 5.5]))]
    hidden = arrived[2].depth.estimate.valid
    assert not hidden[5, 10]
    assert not hidden[5, 12]
    assert hidden[5, 14]
    assert hidden[9, 10]
    assert [one.marker_pixel(CAMERA) is None for one in arrived[:4]] == [False, False, True, False]
    assert arrived[3].depth.estimate.valid.all()
    # A target that is out of view anyway takes nothing with it.
    assert all(one.depth.estimate.valid.all() for _, one in stream(fault))


def test_a_saturated_sensor_reads_its_full_scale():
    injector = FaultInjector((Fault(kind="force-saturates", start_s=1.0, end_s=2.0, full_scale_n=10.0),))
    reading = ProprioceptiveReading(
        tip_in_world=np.zeros(3), tip_velocity_in_world=np.zeros(3), contact_force_in_world=np.array([0.0, 0.3, 0.4])
    )
    np.testing.assert_allclose(injector.reading(reading, 1_500_000_000).contact_force_in_world, [0.0, 6.0, 8.0])
    assert injector.reading(reading, 2_000_000_000) is reading
    silent = replace(reading, contact_force_in_world=np.zeros(3))
    assert np.linalg.norm(injector.reading(silent, 1_500_000_000).contact_force_in_world) == 10.0


def test_a_shaft_comes_to_rest_at_the_end_of_its_way_and_moves_freely_across_it():
    injector = FaultInjector((Fault(kind="tissue-unreachable", start_s=1.0, end_s=2.0, room_m=0.003),))
    axis = np.array([0.6, 0.0, -0.8])
    across, deeper = np.array([0.8, 0.0, 0.6]), 0.06 * axis
    assert injector.velocity(deeper, axis, 0.2, 0.008, 900_000_000) == (deeper, "")
    insertion, speeds = 0.2, []
    for tick in range(100):
        possible, reason = injector.velocity(deeper + 0.01 * across, axis, insertion, 0.008, 1_000_000_000 + tick * 8_000_000)
        assert possible @ across == pytest.approx(0.01)
        speeds.append(float(possible @ axis))
        insertion += 0.008 * speeds[-1]
    assert reason == OUT_OF_REACH
    assert 0.2029 < insertion <= 0.203  # metres: within a tenth of a millimetre of the stop
    # It slows from the 55 mm/s that 3 mm allow, never by more than 1 m/s2.
    assert speeds[0] == pytest.approx(np.sqrt(2.0 * 0.5 * 0.003))
    assert np.abs(np.diff(speeds)).max() <= 0.008
    back, reason = injector.velocity(-deeper, axis, insertion, 0.008, 1_900_000_000)
    assert back is not None
    np.testing.assert_allclose(back, -deeper)
    assert reason == ""


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"kind": "lightning"}, UnknownNameError),
        ({"end_s": 0.5}, InvalidValueError),
        ({"start_s": -1.0}, InvalidValueError),
        ({"full_scale_n": 0.0}, InvalidValueError),
        ({"radius_px": 0.0}, InvalidValueError),
        ({"room_m": 0.0}, InvalidValueError),
    ],
)
def test_faults_that_make_no_sense_are_refused(changes, error):
    with pytest.raises(error):
        Fault(**{"kind": "depth-jump", "start_s": 1.0, "end_s": 2.0, **changes})


def faulty(task_env, run_task, task, kind, start_s, *, lasts_s=0.7, more_s=0.3, **changes):
    """Play a task on breathing and beating tissue with a fault; return the environment and the infos."""
    env = task_env(
        task,
        motion=BaseMotion.named("both"),
        faults=(Fault(kind=kind, start_s=start_s, end_s=start_s + lasts_s),),
        bad_action="hold",
        max_seconds=start_s + lasts_s + more_s,
        **changes,
    )
    return env, run_task(env, seed=3)


def assert_harmless(infos):
    assert any(info["injected_faults"] for info in infos)
    assert max(info["contact_force_n"] for info in infos) <= 2.0
    assert max(max(info["rcm_error_mm"].values()) for info in infos) <= 1.0
    for info in infos:
        assert np.isfinite([info["contact_force_n"], info["target_error_mm"], *info["reward_terms"].values()]).all()
    assert infos[-1]["terminated_by"] in {"time", "success"}


def test_when_perception_stops_under_contact_the_tip_backs_off(task_env, run_task):
    _, infos = faulty(task_env, run_task, "palpate", "perception-stops", CONTACT_S)
    assert_harmless(infos)
    assert any(info["mean_force_n"] > 0.2 for info in infos)
    # Depth ages all the while, and after half a second nothing is pressed any more.
    assert max(info["depth_age_ms"] for info in infos) > 700.0
    assert all(info["mean_force_n"] == 0.0 for info in infos if info["depth_age_ms"] > 690.0)


def test_a_command_that_is_not_a_number_under_contact_lets_the_tissue_push_the_tip_away(task_env, run_task):
    _, infos = faulty(task_env, run_task, "palpate", "controller-nan", CONTACT_S)
    assert_harmless(infos)
    held = [info for info in infos if info["fault"] == "action_not_finite"]
    # 0.7 s of 8 ms, give or take the tick at either end.
    assert abs(len(held) - 88) <= 1
    # The whole breath of 7 mm would press with several newtons.
    assert max(info["mean_force_n"] for info in held) < 1.3


def test_a_saturated_force_sensor_under_contact_makes_the_tool_withdraw(task_env, run_task):
    env, infos = faulty(task_env, run_task, "palpate", "force-saturates", CONTACT_S, lasts_s=0.4, more_s=0.1)
    assert_harmless(infos)
    assert env.loop.max_force_n == 0.0
    assert infos[-1]["target_error_mm"] > 5.0


def test_a_frame_that_jumps_is_not_followed(task_env, run_task):
    _, infos = faulty(task_env, run_task, "track", "depth-jump", 1.3, lasts_s=0.2)
    assert_harmless(infos)
    after = [info for info in infos if info["sim_s"] > 1.3]
    # 20 mm would show; what shows is the error of tracking in the first second, without a learned rhythm.
    assert max(abs(info["normal_error_mm"]) for info in after) < 1.5


def test_a_late_frame_is_dropped_and_counted(task_env, run_task):
    _, infos = faulty(task_env, run_task, "reach", "late-frame", 0.2, lasts_s=0.2, more_s=0.1)
    assert infos[-1]["dropped_frames"] == 1
    ages = np.array([info["depth_age_ms"] for info in infos])
    # No older frame ever takes the place of a newer one: 40 ms of latency, two camera periods while one is missing.
    assert ages.max() < 130.0


@pytest.mark.parametrize("kind", ["depth-invalid", "target-hidden"])
def test_a_camera_that_has_lost_its_target_stands_still(task_env, run_task, kind):
    env, infos = faulty(task_env, run_task, "look", kind, 1.0, lasts_s=0.9, more_s=0.02)
    assert_harmless(infos)
    speed = np.linalg.norm(env.extra_observation()["scope_velocity"])
    # Still since 0.5 s after the target was seen last; the servos' rest is below a tenth of a mm/s.
    assert speed < 1e-3
    assert infos[-1]["in_view"]


@pytest.mark.parametrize("task", ["track", "look"])
def test_out_of_reach_the_moved_arm_slows_holds_and_says_why(task_env, run_task, task):
    start_s = {"track": 0.75, "look": 0.3}[task]
    _, infos = faulty(task_env, run_task, task, "tissue-unreachable", start_s, lasts_s=1.2, more_s=0.02)
    assert_harmless(infos)
    held = [info for info in infos if OUT_OF_REACH in info["status_reason"]]
    assert held
    assert all(info["status"] in {"limited", "held"} for info in held)
    assert all("tissue-unreachable" in info["injected_faults"] for info in held[1:-1])
    assert infos[-1]["terminated_by"] == "time"


@pytest.mark.slow
@pytest.mark.parametrize("kind", get_args(FaultKind))
@pytest.mark.parametrize("task", ["reach", "track", "palpate", "scan", "look"])
def test_no_fault_does_harm_in_any_task(task_env, run_task, task, kind):
    start_s = {"reach": 1.5, "scan": 3.0}.get(task, 2.0)
    _, infos = faulty(task_env, run_task, task, kind, start_s, lasts_s=1.0, more_s=1.5)
    assert_harmless(infos)
