"""A step is Pink's quadratic program: it can be inspected, and a user's tasks, limits and barriers join it."""

import numpy as np
import pytest
import qpsolvers
from pink import PostureTask, Task
from pink.barriers import PositionBarrier
from pink.limits import VelocityLimit

from laploop.assets.shafts import LAPAROSCOPE
from laploop.control.arm.model import SHAFT_TIP
from laploop.control.arm.rcm_config import RcmControllerConfig
from laploop.control.arm.rcm_controller import RcmController, RcmStatus
from laploop.control.arm.rcm_task import RcmTask
from laploop.errors import InvalidValueError

DT = 0.008


class LastJoint(Task):
    """Bring the last joint to an angle."""

    def __init__(self, angle, *, gain=1.0):
        super().__init__(cost=1.0, gain=gain)
        self.angle = angle

    def compute_error(self, configuration):
        return configuration.q[5:] - self.angle

    def compute_jacobian(self, configuration):
        return np.eye(6)[5:]

    def __repr__(self):
        return f"LastJoint({self.angle})"


def start(tool, config=None, **extra):
    controller = RcmController(tool.model, tool.trocar_in_world, config, **extra)
    controller.reset(tool.home_q)
    return controller


def follow(controller, velocity, steps):
    """Follow a velocity; return the worst trocar error in metres."""
    worst = 0.0
    for _ in range(steps):
        controller.step(velocity, DT)
        worst = max(worst, controller.rcm_error_m)
    return worst


def test_the_problem_has_the_trocar_as_equality_and_every_limit_as_rows(tool):
    controller = start(tool)
    tip = tool.model.tip_in_world(controller.q)
    problem = controller.problem(tip + [0.0, 1e-4, 0.0], DT)
    trocar = RcmTask(tool.trocar_in_world)
    np.testing.assert_array_equal(problem.A, trocar.compute_jacobian(controller.configuration))
    np.testing.assert_array_equal(problem.b, -trocar.gain * trocar.compute_error(controller.configuration))
    # Six joints both ways, insertion both ways; neither the wall nor another shaft is near.
    assert problem.G.shape == (14, 6)
    controller.set_other_shaft(tool.world_from_shaft + np.array([[0, 0, 0, 0], [0, 0, 0, 0.02], [0] * 4, [0] * 4]), LAPAROSCOPE)
    assert controller.problem(tip, DT).G.shape == (15, 6)


def test_a_step_is_the_solution_of_the_problem(tool):
    """Also while a limit holds the tip back, when a task of another form takes the place of the frame task."""
    controller = start(tool, RcmControllerConfig(max_insertion_m=0.24))
    deeper = 0.03 * tool.world_from_shaft[:3, 2]
    seen = set()
    for _ in range(60):
        before, velocity = controller.q.copy(), controller._limited(deeper, controller._tip_velocity, DT)
        problem = controller.problem(controller._tip_reference + DT * velocity, DT)
        controller.step(deeper, DT)
        expected = qpsolvers.solve_problem(problem, solver="daqp", primal_tol=1e-9).x
        np.testing.assert_allclose(controller.q - before, expected, rtol=0.0, atol=1e-12)  # radians, rounding
        seen.add(controller.last_status)
    assert seen == {RcmStatus.TRACKING, RcmStatus.LIMITED}


def test_a_task_turns_the_roll_that_tip_and_trocar_leave_free(tool):
    posture = PostureTask(cost=1.0, gain=0.05)
    controller = start(tool, tasks=[posture])
    target = tool.home_q + [0.0, 0.0, 0.0, 0.0, 0.0, 0.5]
    posture.set_target(target)
    reference = start(tool)
    for one in (controller, reference):
        assert follow(one, [0.0, 0.01, 0.0], 100) < 1e-5  # metres
    assert controller.q[5] - tool.home_q[5] > 0.3  # radians
    tips = [tool.model.tip_in_world(one.q) for one in (controller, reference)]
    np.testing.assert_allclose(*tips, atol=2e-6)  # metres: the task's pull, a thousandth of the tip's


def test_a_limit_slows_the_joints_and_is_named(tool):
    controller = start(tool, limits=[VelocityLimit(tool.model.model, np.full(6, 0.02))])
    fastest = 0.0
    for _ in range(60):
        _, qdot = controller.step([0.0, 0.05, 0.0], DT)
        fastest = max(fastest, np.abs(qdot).max())
    assert fastest == pytest.approx(0.02, abs=1e-6)  # rad/s
    assert controller.last_status is RcmStatus.LIMITED
    assert controller.last_reason == "VelocityLimit"


def test_a_barrier_keeps_the_tip_out_and_is_named(tool):
    y = tool.world_from_shaft[1, 3]
    controller = start(tool, barriers=[PositionBarrier(SHAFT_TIP, [1], p_max=np.array([y + 0.005]), gain=10.0)])
    assert follow(controller, [0.0, 0.05, 0.0], 100) < 1e-5  # metres
    # It ends up to 5 um before the bound: Pink's barriers keep their rows over moves that small.
    assert tool.model.tip_in_world(controller.q)[1] == pytest.approx(y + 0.005, abs=2e-5)
    assert controller.last_reason == "PositionBarrier"


def test_a_constraint_is_met_exactly(tool):
    turn = LastJoint(tool.home_q[5] + 0.04, gain=0.02)
    free, held = start(tool), start(tool, constraints=[turn])
    for controller in (free, held):
        assert follow(controller, [-0.02, 0.04, 0.0], 60) < 1e-5  # metres
    left = 0.04 * (1.0 - turn.gain) ** 60
    assert held.q[5] == pytest.approx(turn.angle - left, abs=1e-7)  # radians: the solver's tolerance in 60 steps
    assert free.q[5] == pytest.approx(tool.home_q[5], abs=1e-3)
    tips = [tool.model.tip_in_world(one.q) for one in (free, held)]
    np.testing.assert_allclose(*tips, atol=1e-5)  # metres


@pytest.mark.parametrize("name", ["tasks", "limits", "barriers", "constraints"])
def test_what_is_not_pinks_is_refused(tool, name):
    with pytest.raises(InvalidValueError, match=rf"{name} is 'roll'; allowed: instances of pink's "):
        RcmController(tool.model, tool.trocar_in_world, **{name: ["roll"]})


def test_a_constraint_that_cannot_be_met_holds_the_arm(tool):
    controller = start(tool, constraints=[LastJoint(tool.home_q[5] + 1.0)])
    q, qdot = controller.step([0.0, 0.01, 0.0], DT)
    assert controller.last_status is RcmStatus.HELD
    np.testing.assert_array_equal(q, tool.home_q)
    np.testing.assert_array_equal(qdot, np.zeros(6))


def test_a_posture_beyond_the_limits_of_pinks_model_holds_the_arm(tool):
    controller = start(tool)
    controller.configuration.update(np.array([0.0, 0.0, 3.2, 0.0, 0.0, 0.0]))  # the elbow ends at pi
    controller.step([0.0, 0.01, 0.0], DT)
    assert controller.last_status is RcmStatus.HELD
