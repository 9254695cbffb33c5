"""A scope that pivots at its trocar and looks at a moving plane, all in closed form."""

import numpy as np
import pytest

from laploop.control.controllers.look import LookController, LookControllerConfig
from laploop.control.controllers.phase import Phase
from laploop.control.controllers.scope_motion import scope_tip_velocity
from laploop.control.messages import ControlInput
from laploop.control.targeting.targeting import TargetingConfig
from laploop.errors import InvalidValueError
from laploop.perception.geometry import invert_transform, transform_points
from laploop.perception.messages import DepthEstimate, DepthFrame

TICK_NS, FRAME_NS, LATENCY_NS = 8_000_000, 40_000_000, 40_000_000
TROCAR = np.array([0.0, 0.0, 0.31])


class Scope:
    """A shaft through the trocar with its tip somewhere; turned there by the shortest way, so that it does not roll."""

    def __init__(self, rig, insertion=0.11):
        self.rig = rig
        self.tip = TROCAR - [0.0, 0.0, insertion]

    def world_from_camera(self):
        along = (self.tip - TROCAR) / np.linalg.norm(self.tip - TROCAR)
        down = np.array([0.0, 0.0, -1.0])
        axis = np.cross(down, along)
        cross = np.cross(np.eye(3), axis)
        turn = np.eye(3) + cross + cross @ cross / (1.0 + down @ along)
        pose = np.eye(4)
        pose[:3, :3] = turn @ np.diag([1.0, -1.0, -1.0])
        pose[:3, 3] = self.tip + pose[:3, :3] @ [-0.5 * self.rig.baseline_m, 0.0, 0.0]
        return pose

    def depth(self, floor_z):
        pose = self.world_from_camera()
        return (floor_z - pose[2, 3]) / (self.rig.camera.rays @ pose[2, :3])


def run(
    rig,
    controller,
    seconds,
    *,
    target=(0.015, -0.012),
    floor=0.105,
    motion=lambda _: (0.0, 0.0, 0.0),
    marker=True,
    hide_s=np.inf,
):
    """Return the target in the camera's frame at every tick, (n, 3), and the scope."""
    scope = Scope(rig)
    start = np.array([*target, floor])
    pixel = rig.camera.project(transform_points(invert_transform(scope.world_from_camera()), start))
    on_the_way, newest, seen = [], None, []
    for tick in range(round(seconds * 125)):
        now_ns = tick * TICK_NS
        point = start + motion(now_ns * 1e-9) - np.array(motion(0.0))
        pose = scope.world_from_camera()
        point_in_camera = transform_points(invert_transform(pose), point)
        if now_ns % FRAME_NS == 0:
            depth_mm = (1e3 * scope.depth(point[2])).astype(np.float32)
            estimate = DepthEstimate(depth_mm=depth_mm, valid=np.full(depth_mm.shape, now_ns * 1e-9 < hide_s))
            frame = DepthFrame(
                index=tick,
                estimate=estimate,
                captured_ns=now_ns,
                available_ns=now_ns + LATENCY_NS,
                world_from_camera=pose,
            )
            on_the_way.append((frame, rig.camera.project(point_in_camera) if marker else None))
        while on_the_way and on_the_way[0][0].available_ns <= now_ns:
            newest = on_the_way.pop(0)
        velocity = controller.command(
            ControlInput(
                now_ns=now_ns,
                depth=None if newest is None else newest[0],
                target_pixel=pixel,
                tip_in_camera=transform_points(invert_transform(pose), np.array([0.1, 0.0, 0.2])),
                tip_velocity_in_camera=np.zeros(3),
                trocar_in_camera=transform_points(invert_transform(pose), np.array([0.175, 0.0, 0.31])),
                contact_force_n=0.0,
                world_from_camera=pose,
                scope_trocar_in_camera=transform_points(invert_transform(pose), TROCAR),
                marker_pixel=None if newest is None else newest[1],
            )
        )
        seen.append(point_in_camera)
        scope.tip = scope.tip + 0.008 * pose[:3, :3] @ velocity
    return np.array(seen), scope


def off_centre(rig, points):
    """Return the distance from the image's centre as a fraction of its width."""
    pixels = rig.camera.project(points)
    return np.linalg.norm(pixels - [rig.camera.cx, rig.camera.cy], axis=1) / rig.camera.width


def test_motion_of_a_resting_point_is_that_of_the_interaction_matrix(rig):
    scope = Scope(rig)
    scope.tip = scope.tip + [0.02, -0.01, 0.005]
    point = np.array([0.01, 0.02, 0.1])
    wanted = np.array([0.004, -0.003, 0.002])
    pose = scope.world_from_camera()
    in_camera = transform_points(invert_transform(pose), point)
    way = in_camera - [0.5 * rig.baseline_m, 0.0, 0.0]
    velocity = scope_tip_velocity(wanted, way, float(np.linalg.norm(scope.tip - TROCAR)))
    small = 1e-4  # seconds
    scope.tip = scope.tip + small * pose[:3, :3] @ velocity
    after = transform_points(invert_transform(scope.world_from_camera()), point)
    # Exact but for the roll that turning by the shortest way has in the world, and for the second order.
    np.testing.assert_allclose((after - in_camera) / small, wanted, atol=2e-4)  # m/s


@pytest.mark.parametrize("target", [(0.015, -0.012), (-0.02, 0.018)])
def test_target_is_centred_at_the_working_distance_after_two_seconds(rig, target):
    points, _ = run(rig, LookController(rig), 4.0, target=target)
    assert off_centre(rig, points[250:]).max() < 0.05
    assert np.abs(points[250:, 2] - 0.085).max() < 0.005  # metres
    assert off_centre(rig, points[-1:])[0] < 0.002
    assert abs(points[-1, 2] - 0.085) < 1e-4


def test_target_that_breathes_and_travels_stays_centred(rig, breathing):
    def motion(time_s):
        return 0.008 * np.sin(0.5 * time_s), 0.006 * np.sin(0.3 * time_s), breathing(time_s)

    points, _ = run(rig, LookController(rig), 8.0, motion=motion)
    assert off_centre(rig, points[250:]).max() < 0.05
    assert np.abs(points[250:, 2] - 0.085).max() < 0.005  # metres


def test_without_a_marker_motion_along_the_first_view_is_followed(rig, breathing):
    points, _ = run(rig, LookController(rig), 6.0, motion=lambda time_s: (0.0, 0.0, breathing(time_s)), marker=False)
    assert off_centre(rig, points[250:]).max() < 0.05
    assert np.abs(points[250:, 2] - 0.085).max() < 0.005  # metres


def test_camera_stands_still_while_the_target_is_out_of_sight(rig):
    controller = LookController(rig)
    points, _ = run(rig, controller, 4.0, hide_s=0.5)
    assert controller.phase is Phase.LOST
    np.testing.assert_array_equal(points[-1], points[-100])


def test_camera_keeps_its_distance_from_the_tissue(rig):
    controller = LookController(rig, LookControllerConfig(min_clearance_m=0.09))
    points, _ = run(rig, controller, 4.0)
    assert points[:, 2].min() > 0.0895  # metres, though it should come to 0.085


def test_missing_pose_or_trocar_is_named(rig, make_frame):
    controller = LookController(rig)
    state = {
        "now_ns": 0,
        "depth": None,
        "target_pixel": np.array([128.5, 128.5]),
        "tip_in_camera": np.zeros(3),
        "tip_velocity_in_camera": np.zeros(3),
        "trocar_in_camera": np.zeros(3),
        "contact_force_n": 0.0,
    }
    with pytest.raises(InvalidValueError, match="scope_trocar_in_camera"):
        controller.command(ControlInput(**state))
    with pytest.raises(InvalidValueError, match="world_from_camera"):
        controller.command(ControlInput(**state, scope_trocar_in_camera=np.array([0.0, 0.0, -0.1])))


def test_targeting_that_does_not_follow_the_camera_is_refused():
    with pytest.raises(InvalidValueError, match="follow_camera"):
        LookControllerConfig(targeting=TargetingConfig())
