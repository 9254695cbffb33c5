import numpy as np
import pytest
from pink import Configuration

from laploop.control.arm.joint_limit import JointBoxLimit

DT = 0.008


@pytest.fixture
def box(tool):
    return JointBoxLimit(tool.model.lower_position, tool.model.upper_position, np.full(6, 1.0), np.full(6, 15.0))


def bounds(limit, tool, q):
    model = tool.model.model.copy()
    rows, bound = limit.compute_qp_inequalities(Configuration(model, model.createData(), q), DT)
    np.testing.assert_array_equal(rows, np.vstack([np.eye(6), -np.eye(6)]))
    return bound[:6], -bound[6:]


def test_at_rest_far_from_limits_acceleration_decides(box, tool):
    upper, lower = bounds(box, tool, np.zeros(6))
    np.testing.assert_allclose(upper, 15.0 * DT**2)
    np.testing.assert_allclose(lower, -15.0 * DT**2)


def test_at_full_speed_the_speed_limit_decides_ahead_and_the_brakes_behind(box, tool):
    box.set_last_velocity(np.full(6, 1.0))
    upper, lower = bounds(box, tool, np.zeros(6))
    np.testing.assert_allclose(upper, 1.0 * DT)
    np.testing.assert_allclose(lower, (1.0 - 15.0 * DT) * DT)


def test_near_a_position_limit_half_of_the_way_is_left_and_beyond_it_nothing(box, tool):
    q = tool.model.upper_position - 1e-4
    assert np.allclose(bounds(box, tool, q)[0], 5e-5)
    assert np.all(bounds(box, tool, tool.model.upper_position + 1e-3)[0] == 0.0)


def test_the_speed_towards_a_limit_is_one_that_the_joint_can_brake_from(box, tool):
    box.set_last_velocity(np.full(6, 1.0))
    left = 0.02
    upper, _ = bounds(box, tool, tool.model.upper_position - left)
    np.testing.assert_allclose(upper, DT * np.sqrt(2.0 * 15.0 * left))


def test_without_acceleration_speed_and_position_remain(tool):
    box = JointBoxLimit(tool.model.lower_position, tool.model.upper_position, np.full(6, 1.0), None)
    upper, lower = bounds(box, tool, np.zeros(6))
    np.testing.assert_allclose([upper, -lower], 1.0 * DT)
