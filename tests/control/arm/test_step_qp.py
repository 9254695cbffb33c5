import numpy as np
import pytest
import qpsolvers
from pink import build_ik

from laploop.assets.shafts import LAPAROSCOPE
from laploop.control.arm.rcm_controller import RcmController, RcmControllerConfig, RcmStatus
from laploop.control.arm.step_qp import StepQp

DT = 0.008


def reference(controller, limits):
    """Solve what the controller has set up for its last step as Pink builds it and qpsolvers hands it on."""
    problem = build_ik(
        controller._configuration,
        [controller._tip_task, controller._posture_task],
        DT,
        limits=limits,
        constraints=[controller._trocar_task],
    )
    return problem, qpsolvers.solve_problem(problem, solver="daqp", primal_tol=1e-9)


def assembled(controller, limits):
    program = StepQp(6, 24, 1e-9)
    program.assemble(
        controller._configuration, [controller._tip_task, controller._posture_task], limits, controller._trocar_task, DT
    )
    return program


@pytest.mark.parametrize("near", [False, True])
def test_steps_are_those_of_pink_and_qpsolvers(tool, near):
    """Over random postures, wishes and last velocities; with limits active and not, near another shaft and the wall and not."""
    rng = np.random.default_rng(int(near))
    rooms = {"min_tip_depth_m": 0.06, "min_flange_height_m": 0.12} if near else {}
    controller = RcmController(tool.model, tool.trocar_in_world, RcmControllerConfig(**rooms))
    scope = tool.world_from_shaft.copy()
    scope[:3, 3] += [0.0, 0.02, 0.0]
    active = free = rows = 0
    for _ in range(300):
        controller.reset(tool.home_q)
        if near:
            controller.set_other_shaft(scope, LAPAROSCOPE)
        controller._configuration.update(tool.home_q + 0.03 * rng.normal(size=6))
        # From a slow wish that no limit holds back to one that many do.
        controller._qdot = rng.choice([0.001, 0.3]) * rng.normal(size=6)
        tip = controller._tip_in_world()
        controller._tasks_towards(tip + rng.choice([1e-6, 1e-3]) * rng.normal(size=3), DT)
        limits = controller._limits if rng.random() < 0.5 else controller._braking_limits
        problem, theirs = reference(controller, limits)
        program = assembled(controller, limits)
        ours = program.solve()
        assert (ours is None) == (not theirs.found)
        if ours is None:
            continue
        np.testing.assert_allclose(ours, theirs.x, rtol=0.0, atol=1e-10)  # radians; to the bit where numpy's kernels agree
        np.testing.assert_allclose(program.room(ours), problem.h - problem.G @ theirs.x, atol=1e-12)
        used = program.room(ours).min() < 1e-9
        active, free = active + used, free + (not used)
        rows = max(rows, len(problem.h))
    assert min(active, free) > 30
    assert (rows > 14) == near


def test_contradicting_limits_have_no_step(tool):
    controller = RcmController(tool.model, tool.trocar_in_world)
    controller.reset(tool.home_q)
    controller._qdot = np.array([0.9, 0.9, -0.9, 0.9, 0.9, -0.9])
    controller._tasks_towards(controller._tip_in_world(), DT)
    assert not reference(controller, controller._limits)[1].found
    assert assembled(controller, controller._limits).solve() is None


def test_the_controllers_own_step_is_the_problems(tool):
    """Also while a limit holds the tip back, when another task takes the place of the first."""
    controller = RcmController(tool.model, tool.trocar_in_world, RcmControllerConfig(max_insertion_m=0.24))
    controller.reset(tool.home_q)
    deeper = 0.03 * tool.world_from_shaft[:3, 2]
    seen = set()
    for _ in range(60):
        before, velocity = controller.q.copy(), controller._limited(deeper, controller._tip_velocity, DT)
        problem = controller.problem(controller._tip_reference + DT * velocity, DT)
        controller.step(deeper, DT)
        expected = qpsolvers.solve_problem(problem, solver="daqp", primal_tol=1e-9).x
        np.testing.assert_allclose(controller.q - before, expected, rtol=0.0, atol=1e-10)  # radians
        seen.add(controller.last_status)
    assert seen == {RcmStatus.TRACKING, RcmStatus.LIMITED}
