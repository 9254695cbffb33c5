import numpy as np
import pytest

from laploop.assets.shafts import LAPAROSCOPE
from laploop.control.arm.clearance_limits import ShaftClearanceLimit, WallLimit, nearest_parameters
from laploop.control.arm.rcm_config import RcmControllerConfig
from laploop.control.arm.rcm_controller import RcmController, RcmStatus
from laploop.errors import InvalidValueError

DT = 0.008


def parallel_scope(tool, gap, lateral=(0.0, 1.0, 0.0)):
    """Return the pose of a scope whose shaft runs beside the tool's, so that the surfaces are `gap` apart."""
    pose = tool.world_from_shaft.copy()
    pose[:3, 3] = pose[:3, 3] + (gap + 0.0025 + 0.006) * np.array(lateral)
    return pose


def start(tool, **options):
    controller = RcmController(tool.model, tool.trocar_in_world, RcmControllerConfig(**options))
    controller.reset(tool.home_q)
    return controller


def test_nearest_parameters_are_those_of_a_fine_grid():
    rng = np.random.default_rng(0)
    grid = np.linspace(0.0, 1.0, 401)
    for _ in range(100):
        a, b, c, d = rng.normal(size=(4, 3))
        s, t = nearest_parameters(a, b, c, d)
        found = np.linalg.norm(a + s * (b - a) - c - t * (d - c))
        first = a + grid[:, None] * (b - a)
        second = c + grid[:, None] * (d - c)
        least = np.linalg.norm(first[:, None] - second[None], axis=2).min()
        assert least - 0.02 < found < least + 1e-12  # the grid's step times a segment's length


def test_nearest_points_of_parallel_segments_are_found():
    s, t = nearest_parameters(np.zeros(3), np.array([1.0, 0, 0]), np.array([0.5, 1.0, 0]), np.array([2.0, 1.0, 0]))
    assert s - 0.5 - 1.5 * t == pytest.approx(0.0)


def test_shaft_comes_to_rest_before_another_one(tool):
    controller = start(tool)
    controller.set_other_shaft(parallel_scope(tool, 0.012), LAPAROSCOPE)
    assert controller.shaft_clearance_m == pytest.approx(0.012, abs=1e-6)
    for _ in range(100):
        _, qdot = controller.step([0.0, 0.05, 0.0], DT)
        assert controller.last_status is not RcmStatus.HELD
        assert controller.rcm_error_m < 1e-5
    assert controller.shaft_clearance_m == pytest.approx(0.003, abs=1e-4)
    assert controller.last_status is RcmStatus.LIMITED
    assert "the other shaft" in controller.last_reason
    assert np.abs(qdot).max() < 0.01  # rad/s: no joint runs away for nothing
    for _ in range(40):
        controller.step([0.0, -0.03, 0.0], DT)
    assert controller.last_status is RcmStatus.TRACKING
    assert controller.last_reason == ""
    assert controller.shaft_clearance_m > 0.008


def test_shaft_slides_along_another_one(tool):
    controller = start(tool)
    controller.set_other_shaft(parallel_scope(tool, 0.006), LAPAROSCOPE)
    deeper = tool.world_from_shaft[:3, 2]
    before = controller.insertion_m
    for _ in range(100):
        controller.step(0.03 * deeper + [0.0, 0.02, 0.0], DT)
    assert controller.insertion_m - before > 0.02
    assert controller.shaft_clearance_m > 0.0029


def test_shaft_that_is_already_too_near_may_stand_still_and_leave(tool):
    controller = start(tool)
    upright = parallel_scope(tool, 0.001)
    upright[:3, :3] = np.diag([1.0, -1.0, -1.0])
    controller.set_other_shaft(upright, LAPAROSCOPE)
    controller.step([0.0, 0.02, 0.0], DT)
    assert controller.last_status is not RcmStatus.HELD
    for _ in range(50):
        controller.step([0.0, -0.02, 0.0], DT)
    assert controller.shaft_clearance_m > 0.005


def test_far_shaft_and_wall_change_no_bit(tool):
    far = np.eye(4)
    far[:3, :3] = np.diag([1.0, -1.0, -1.0])
    far[:3, 3] = [-0.1, 0.0, 0.2]
    ends = []
    for watched in (True, False):
        controller = start(tool, wall_outwards=(0.0, 0.0, 1.0) if watched else "none")
        if watched:
            controller.set_other_shaft(far, LAPAROSCOPE)
        for i in range(60):
            controller.step([0.02 * np.sin(i), 0.02, -0.01], DT)
        ends.append(controller.q.copy())
    np.testing.assert_array_equal(*ends)


def test_forgotten_shaft_is_no_obstacle(tool):
    controller = start(tool)
    controller.set_other_shaft(parallel_scope(tool, 0.006), LAPAROSCOPE)
    controller.forget_other_shaft()
    assert controller.shaft_clearance_m == np.inf
    for _ in range(40):
        controller.step([0.0, 0.05, 0.0], DT)
    assert controller.last_status is RcmStatus.TRACKING


def test_tip_stays_below_the_wall(tool):
    controller = start(tool, min_tip_depth_m=0.05)
    out = -tool.world_from_shaft[:3, 2]
    for _ in range(600):
        controller.step(0.05 * out, DT)
        assert controller.rcm_error_m < 4e-5  # metres, in the middle of a steep turn of the wrist
    depth = tool.trocar_in_world[2] - tool.model.tip_in_world(controller.q)[2]
    assert depth == pytest.approx(0.05, abs=1e-4)
    assert "the wall, at the tip" in controller.last_reason


def test_flange_stays_above_the_wall(tool):
    controller = start(tool, min_flange_height_m=0.12)
    deeper = tool.world_from_shaft[:3, 2]
    for _ in range(600):
        controller.step(0.05 * deeper, DT)
    pose = tool.model.world_from_shaft(controller.q)
    flange = pose[:3, 3] - tool.model.shaft.length_m * pose[:3, 2]
    assert flange[2] - tool.trocar_in_world[2] == pytest.approx(0.12, abs=1e-4)
    assert "the wall, at the flange" in controller.last_reason


def test_limits_of_joints_and_insertion_are_named(tool):
    controller = start(tool, max_insertion_m=0.24)
    deeper = tool.world_from_shaft[:3, 2]
    for _ in range(100):
        controller.step(0.03 * deeper, DT)
    assert "insertion, longest" in controller.last_reason
    slow = start(tool, max_joint_speed_radps=0.01)
    for _ in range(50):
        slow.step([0.0, 0.05, 0.0], DT)
    assert slow.last_status is RcmStatus.LIMITED
    assert "speed of joint" in slow.last_reason


def test_gradients_are_those_of_differences(tool):
    configuration = start(tool).configuration
    scope = parallel_scope(tool, 0.01, (0.3, 0.9, 0.1))
    scope[:3, :3] = np.diag([1.0, -1.0, -1.0])
    shaft = ShaftClearanceLimit(length_m=0.43, radius_m=0.0025, min_clearance_m=0.003)
    shaft.set_other(scope[:3, 3], scope[:3, 3] + [0.0, 0.0, 0.42], 0.006)
    wall = WallLimit(tool.trocar_in_world, [0, 0, 2], length_m=0.43, min_tip_depth_m=0.15, min_flange_height_m=0.14)
    at = configuration.q.copy()
    shaft_row, shaft_bound = shaft.compute_qp_inequalities(configuration, DT)
    wall_rows, wall_bounds = wall.compute_qp_inequalities(configuration, DT)
    assert wall_rows.shape == (2, 6)
    for joint in range(6):
        moved = at.copy()
        moved[joint] += 1e-6
        configuration.update(moved)
        rise = shaft.compute_qp_inequalities(configuration, DT)[1] / 0.1 - shaft_bound / 0.1
        np.testing.assert_allclose(rise / 1e-6, -shaft_row[:, joint], atol=1e-4)
        if wall_bounds.min() > 0.0:
            rises = (wall.compute_qp_inequalities(configuration, DT)[1] - wall_bounds) / 0.1
            np.testing.assert_allclose(rises / 1e-6, -wall_rows[:, joint], atol=1e-4)
    assert wall_bounds.min() > 0.0


def test_crossing_axes_still_have_a_way_out(tool):
    configuration = start(tool).configuration
    limit = ShaftClearanceLimit(length_m=0.43, radius_m=0.0025, min_clearance_m=0.003)
    tip, along = tool.world_from_shaft[:3, 3], tool.world_from_shaft[:3, 2]
    across = np.cross(along, [0.0, 1.0, 0.0])
    middle = tip - 0.1 * along
    limit.set_other(middle - 0.1 * across, middle + 0.1 * across, 0.006)
    row, bound = limit.compute_qp_inequalities(configuration, DT)
    assert np.isfinite(row).all()
    assert bound[0] == 0.0


def test_bad_arguments_are_named(tool):
    with pytest.raises(InvalidValueError, match="outwards"):
        WallLimit(tool.trocar_in_world, [0, 0, 0], length_m=0.4, min_tip_depth_m=0.0, min_flange_height_m=0.1)
    limit = ShaftClearanceLimit(length_m=0.4, radius_m=0.002, min_clearance_m=0.003)
    with pytest.raises(InvalidValueError, match="radius_m"):
        limit.set_other([0, 0, 0], [0, 0, 1], -1.0)
    with pytest.raises(InvalidValueError, match="tip_in_world"):
        limit.set_other([0, 0, np.nan], [0, 0, 1], 0.01)
    with pytest.raises(InvalidValueError, match="min_tip_depth_m"):
        RcmControllerConfig(min_tip_depth_m=-1.0)
