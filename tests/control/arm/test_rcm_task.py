import numpy as np
import pytest
from pink import Configuration

from laploop.control.arm.rcm_task import InsertionLimit, RcmTask, TipPositionTask, trocar_in_shaft, trocar_jacobian
from laploop.errors import InvalidValueError


@pytest.fixture
def configuration(tool):
    model = tool.model.model.copy()
    return Configuration(model, model.createData(), tool.home_q)


def differences(configuration, function, step=1e-6):
    q = np.array(configuration.q)
    columns = []
    for joint in range(6):
        values = []
        for sign in (1.0, -1.0):
            configuration.update(q + sign * step * np.eye(6)[joint])
            values.append(np.array(function(configuration)))
        columns.append((values[0] - values[1]) / (2.0 * step))
    configuration.update(q)
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("seed", range(4))
def test_jacobians_match_finite_differences(tool, configuration, seed):
    configuration.update(np.random.default_rng(seed).uniform(-2.5, 2.5, 6))
    trocar = tool.trocar_in_world
    expected = differences(configuration, lambda c: trocar_in_shaft(c, trocar))
    point = trocar_in_shaft(configuration, trocar)
    # Central differences of step 1e-6: truncation and rounding below 1e-9.
    np.testing.assert_allclose(trocar_jacobian(configuration, point), expected, atol=1e-8)
    task = RcmTask(trocar)
    np.testing.assert_allclose(task.compute_jacobian(configuration), expected[:2], atol=1e-8)


def test_offset_is_the_distance_of_the_trocar_from_the_axis(tool, configuration):
    sideways = tool.world_from_shaft[:3, :3] @ np.array([0.003, -0.004, 0.1])
    offset = RcmTask(tool.trocar_in_world + sideways).offset(configuration)
    np.testing.assert_allclose(offset, [0.003, -0.004], atol=1e-9)  # metres, tolerance of the start posture


def test_large_error_is_cut_to_what_one_step_may_correct(tool, configuration):
    sideways = tool.world_from_shaft[:3, :3] @ np.array([0.003, -0.004, 0.0])
    task = RcmTask(tool.trocar_in_world + sideways, feedback=0.5, max_correction_m=4e-5)
    step = task.gain * task.compute_error(configuration)
    np.testing.assert_allclose(step, [2.4e-5, -3.2e-5], atol=1e-10)  # metres: 40 um along the offset


def test_small_error_is_not_cut(tool, configuration):
    sideways = tool.world_from_shaft[:3, :3] @ np.array([1e-6, 0.0, 0.0])
    task = RcmTask(tool.trocar_in_world + sideways)
    np.testing.assert_allclose(task.compute_error(configuration), task.offset(configuration), rtol=1e-12)


def test_insertion_limit_leaves_half_of_the_way_that_is_left(tool, configuration):
    limit = InsertionLimit(tool.trocar_in_world, min_m=0.13, max_m=0.25)  # 0.23 m are inserted
    matrix, bound = limit.compute_qp_inequalities(configuration, 0.008)
    np.testing.assert_allclose(bound, [0.01, 0.05], atol=1e-9)  # metres
    expected = differences(configuration, lambda c: -trocar_in_shaft(c, tool.trocar_in_world)[2:])
    np.testing.assert_allclose(matrix[0], expected[0], atol=1e-8)  # finite differences, as above
    np.testing.assert_array_equal(matrix[1], -matrix[0])


def test_beyond_the_insertion_limit_standing_still_stays_allowed(tool, configuration):
    _, bound = InsertionLimit(tool.trocar_in_world, min_m=0.05, max_m=0.20).compute_qp_inequalities(configuration, 0.008)
    assert bound[0] == 0.0
    assert bound[1] > 0.0


@pytest.mark.parametrize("options", [{"feedback": 0.0}, {"feedback": 1.5}, {"max_correction_m": 0.0}])
def test_bad_feedback_is_refused(tool, options):
    with pytest.raises(InvalidValueError, match=next(iter(options))):
        RcmTask(tool.trocar_in_world, **options)


def test_bad_geometry_is_refused(tool):
    with pytest.raises(InvalidValueError, match="trocar_in_world"):
        RcmTask([0.0, np.nan, 0.0])
    with pytest.raises(InvalidValueError, match="insertion limits"):
        InsertionLimit(tool.trocar_in_world, min_m=0.2, max_m=0.1)


def test_task_shows_its_trocar():
    assert "[0.0, 0.0, 1.0]" in repr(RcmTask([0.0, 0.0, 1.0]))


def test_tip_position_task_has_the_jacobian_of_its_error_and_no_part_of_the_roll(tool, configuration):
    task = TipPositionTask(1e3)
    task.target_in_world = np.array([0.03, 0.0, 0.09])
    expected = tool.model.tip_in_world(tool.home_q) - task.target_in_world
    np.testing.assert_allclose(task.compute_error(configuration), expected, atol=1e-12)
    jacobian = task.compute_jacobian(configuration)
    np.testing.assert_allclose(jacobian, differences(configuration, task.compute_error), atol=1e-8)
    np.testing.assert_allclose(jacobian[:, 5], 0.0, atol=1e-9)
    assert "TipPositionTask" in repr(task)
