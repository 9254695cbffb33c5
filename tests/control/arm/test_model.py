import math

import numpy as np
import pinocchio as pin
import pytest

from laploop.assets.shafts import INSTRUMENT, LAPAROSCOPE
from laploop.control.arm.model import SHAFT_TIP, ArmModel
from laploop.errors import InvalidValueError


def postures(count, seed=0):
    return np.random.default_rng(seed).uniform(-2.5, 2.5, (count, 6))


def test_tip_lies_the_shafts_length_beyond_the_flange_along_its_z():
    arm = ArmModel(np.eye(4), LAPAROSCOPE)
    data = arm.model.createData()
    for q in postures(5):
        pin.framesForwardKinematics(arm.model, data, q)
        flange = data.oMf[arm.model.getFrameId("tool0")]
        expected = flange.act(np.array([0.0, 0.0, LAPAROSCOPE.length_m]))
        np.testing.assert_allclose(arm.tip_in_world(q), expected, atol=1e-14)  # metres, rounding


def test_base_moves_every_frame(tool):
    at_origin = ArmModel(np.eye(4), INSTRUMENT)
    for q in postures(5):
        expected = tool.model.world_from_base @ at_origin.world_from_shaft(q)
        np.testing.assert_allclose(tool.model.world_from_shaft(q), expected, atol=1e-14)  # rounding
    data = tool.model.model.createData()
    pin.framesForwardKinematics(tool.model.model, data, np.zeros(6))
    base = data.oMf[tool.model.model.getFrameId("base_link")].homogeneous
    np.testing.assert_allclose(base, tool.model.world_from_base, atol=1e-14)  # rounding


def test_tip_jacobian_matches_finite_differences(tool):
    step = 1e-6
    for q in postures(5):
        jacobian = tool.model.tip_jacobian(q)
        pose = tool.model.world_from_shaft(q)
        for joint in range(6):
            shift = step * np.eye(6)[joint]
            after, before = tool.model.world_from_shaft(q + shift), tool.model.world_from_shaft(q - shift)
            linear = (after[:3, 3] - before[:3, 3]) / (2.0 * step)
            spin = (after[:3, :3] - before[:3, :3]) @ pose[:3, :3].T / (2.0 * step)
            angular = [spin[2, 1], spin[0, 2], spin[1, 0]]
            # Central differences of step 1e-6: truncation and rounding below 1e-9.
            np.testing.assert_allclose(jacobian[:, joint], [*linear, *angular], atol=1e-8)


def test_trocar_in_shaft_is_offset_and_inserted_length(tool):
    point = tool.model.trocar_in_shaft(tool.home_q, tool.trocar_in_world)
    np.testing.assert_allclose(point, [0.0, 0.0, -0.23], atol=1e-9)  # metres, tolerance of the start posture


def test_limits_are_those_of_the_data_sheet_and_read_only(tool):
    full = 2.0 * math.pi
    np.testing.assert_array_equal(tool.model.upper_position, [full, full, math.pi, full, full, full])
    np.testing.assert_array_equal(tool.model.lower_position, -tool.model.upper_position)
    np.testing.assert_array_equal(tool.model.max_joint_speed, np.full(6, math.pi))
    for array in (
        tool.model.upper_position,
        tool.model.lower_position,
        tool.model.max_joint_speed,
        tool.model.world_from_base,
    ):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0


def test_results_are_copies(tool):
    first = tool.model.tip_in_world(tool.home_q)
    kept = first.copy()
    tool.model.tip_in_world(tool.home_q + 0.1)
    np.testing.assert_array_equal(first, kept)


def test_model_knows_its_shaft(tool):
    assert tool.model.shaft is INSTRUMENT
    assert tool.model.dof == 6
    assert tool.model.model.existFrame(SHAFT_TIP)


@pytest.mark.parametrize("q", [np.zeros(5), [0.0, 0.0, np.nan, 0.0, 0.0, 0.0]])
def test_bad_joint_angles_are_refused(tool, q):
    with pytest.raises(InvalidValueError, match="joint angles"):
        tool.model.world_from_shaft(q)


@pytest.mark.parametrize("transform", [np.diag([2.0, 1.0, 1.0, 1.0]), np.diag([-1.0, 1.0, 1.0, 1.0]), np.eye(3)])
def test_base_that_is_not_rigid_is_refused(transform):
    with pytest.raises(InvalidValueError, match="world_from_base"):
        ArmModel(transform, INSTRUMENT)
