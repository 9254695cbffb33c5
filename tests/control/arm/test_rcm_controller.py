import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
from pink.exceptions import NoSolutionFound

from laploop.control.arm.rcm_config import RcmControllerConfig
from laploop.control.arm.rcm_controller import RcmController, RcmStatus
from laploop.errors import InfeasibleError, InvalidValueError

DT = 0.008


@pytest.fixture
def controller(tool):
    controller = RcmController(tool.model, tool.trocar_in_world, RcmControllerConfig())
    controller.reset(tool.home_q)
    return controller


def test_trocar_is_held_along_a_loop(tool, controller):
    radius, speed = 0.01, 0.03
    start = tool.model.tip_in_world(tool.home_q)
    worst, time = 0.0, 0.0
    for _ in range(round(3 * 2.0 * np.pi * radius / speed / DT)):
        angle = speed / radius * time
        controller.step(speed * np.array([-np.sin(angle), np.cos(angle), 0.3 * np.sin(2.0 * angle)]), DT)
        worst = max(worst, controller.rcm_error_m)
        time += DT
        assert controller.last_status is RcmStatus.TRACKING
    assert worst < 1e-5  # metres; 0.7 um measured
    # Three turns of the loop end where they began, but for the start of the motion under limited acceleration.
    assert np.linalg.norm(tool.model.tip_in_world(controller.q) - start) < 1.5e-3


def test_tip_follows_a_wanted_velocity(tool, controller):
    wanted = np.array([-0.01, 0.02, -0.015])
    for _ in range(20):
        controller.step(wanted, DT)
    before = tool.model.tip_in_world(controller.q)
    controller.step(wanted, DT)
    reached = (tool.model.tip_in_world(controller.q) - before) / DT
    np.testing.assert_allclose(reached, wanted, atol=2e-5)  # m/s; what is second order in a step of 0.2 mm


def test_step_returns_where_the_period_begins_and_the_speed_that_leads_through_it(tool, controller):
    q, qdot = controller.step([0.0, 0.01, 0.0], DT)
    np.testing.assert_array_equal(q, tool.home_q)
    np.testing.assert_allclose(q + DT * qdot, controller.q, atol=1e-15)  # rad, rounding
    following, _ = controller.step([0.0, 0.01, 0.0], DT)
    np.testing.assert_array_equal(following, controller.q - DT * _)


def test_tip_speed_and_acceleration_are_limited(tool, controller):
    config = RcmControllerConfig()
    tips = [tool.model.tip_in_world(controller.q)]
    for _ in range(30):
        controller.step([0.0, 1.0, 0.0], DT)
        tips.append(tool.model.tip_in_world(controller.q))
    velocity = np.diff(tips, axis=0) / DT
    # 1 % for what is second order in a step of half a millimetre.
    assert np.linalg.norm(velocity, axis=1).max() < 1.01 * config.max_tip_speed_mps
    assert np.linalg.norm(np.diff(velocity, axis=0), axis=1).max() < 1.01 * config.max_tip_acceleration_mps2 * DT
    assert np.linalg.norm(velocity[-1]) > 0.99 * config.max_tip_speed_mps


def test_wild_requests_keep_trocar_and_limits(tool, controller):
    rng = np.random.default_rng(0)
    config = RcmControllerConfig()
    worst_error = fastest = 0.0
    for i in range(2500):
        if i % 150 == 0:
            wanted = rng.normal(size=3)
            wanted *= rng.uniform(0.0, 0.3) / np.linalg.norm(wanted)
        _, qdot = controller.step(wanted, DT)
        worst_error = max(worst_error, controller.rcm_error_m)
        fastest = max(fastest, np.abs(qdot).max())
        assert np.all(np.abs(controller.q) <= tool.model.upper_position + 1e-9)  # rad, rounding
        assert 0.02 - 1e-4 < controller.insertion_m < 0.38 + 1e-4  # metres, first-order steps
    assert worst_error < 5e-5  # metres; 14 um measured, close to singular postures
    assert fastest <= config.max_joint_speed_radps * (1.0 + 1e-6)  # the solver's primal tolerance


def test_joint_acceleration_is_limited_while_tracking(tool):
    config = replace(RcmControllerConfig(), max_joint_acceleration_radps2=0.5)
    controller = RcmController(tool.model, tool.trocar_in_world, config)
    controller.reset(tool.home_q)
    previous, changes = np.zeros(6), []
    for _ in range(40):
        _, qdot = controller.step([0.0, 0.05, 0.0], DT)
        if controller.last_status is not RcmStatus.HELD:
            changes.append(np.abs(qdot - previous).max())
        previous = qdot
    # rad/s, the solver's primal tolerance; the wish is large enough for the limit to be what decides.
    assert len(changes) > 20
    assert max(changes) == pytest.approx(0.5 * DT, abs=1e-6)


def test_insertion_stops_at_its_limit(tool):
    config = RcmControllerConfig(max_insertion_m=0.24)  # 10 mm below the start
    controller = RcmController(tool.model, tool.trocar_in_world, config)
    controller.reset(tool.home_q)
    deeper = 0.03 * tool.world_from_shaft[:3, 2]
    for _ in range(100):
        controller.step(deeper, DT)
    assert controller.insertion_m == pytest.approx(0.24, abs=2e-5)  # metres, first-order steps
    assert controller.last_status is RcmStatus.LIMITED
    assert controller.rcm_error_m < 1e-5
    # It comes back without having wound up: the reference is at most half a millimetre ahead.
    for _ in range(25):
        controller.step(-deeper, DT)
    assert controller.insertion_m < 0.2375


def unsolvable(*args, **kwargs):
    raise NoSolutionFound(None, None)


def test_infeasible_problem_holds_and_reports(tool, controller, monkeypatch):
    for _ in range(10):
        controller.step([0.0, 0.04, 0.0], DT)
    before = controller.q.copy()
    monkeypatch.setattr("laploop.control.arm.rcm_controller.solve_ik", unsolvable)
    q, qdot = controller.step([0.0, 0.04, 0.0], DT)
    assert controller.last_status is RcmStatus.HELD
    np.testing.assert_array_equal(q, before)
    np.testing.assert_array_equal(qdot, np.zeros(6))
    np.testing.assert_array_equal(controller.q, before)
    monkeypatch.undo()
    controller.step([0.0, 0.04, 0.0], DT)
    assert controller.last_status is RcmStatus.TRACKING


def test_contradicting_accelerations_brake_the_tip(tool, controller):
    for _ in range(12):
        controller.step([0.0, 0.06, 0.0], DT)
    # A previous velocity off the trocar's constraint cannot be changed fast enough to meet it.
    controller._qdot = np.array([0.9, 0.9, -0.9, 0.9, 0.9, -0.9])
    controller.step([0.0, 0.06, 0.0], DT)
    assert controller.last_status is RcmStatus.HELD
    assert controller.rcm_error_m < 1e-5  # metres: the trocar goes first


def test_start_off_the_trocar_is_walked_back(tool):
    sideways = tool.world_from_shaft[:3, :3] @ np.array([0.0005, 0.0, 0.0])
    controller = RcmController(tool.model, tool.trocar_in_world + sideways, RcmControllerConfig())
    controller.reset(tool.home_q)
    errors = [controller.rcm_error_m]
    for _ in range(40):
        controller.step(np.zeros(3), DT)
        errors.append(controller.rcm_error_m)
    assert np.diff(errors).min() > -4.1e-5  # metres a step: 5 mm/s
    assert errors[-1] < 1e-6  # metres


def test_shaft_that_misses_the_trocar_is_refused(tool):
    controller = RcmController(tool.model, tool.trocar_in_world + [0.0, 0.005, 0.0], RcmControllerConfig())
    with pytest.raises(InfeasibleError, match=r"misses the trocar by 5\.000 mm"):
        controller.reset(tool.home_q)


def test_posture_outside_the_limits_is_refused(tool, controller):
    with pytest.raises(InvalidValueError, match="joint angles"):
        controller.reset([0.0, 0.0, 4.0, 0.0, 0.0, 0.0])


def test_step_before_reset_is_refused(tool):
    controller = RcmController(tool.model, tool.trocar_in_world)
    with pytest.raises(InfeasibleError, match=r"reset\(q\)"):
        controller.step(np.zeros(3), DT)


@pytest.mark.parametrize("velocity", [[0.0, np.nan, 0.0], [0.0, 0.0]])
def test_bad_velocity_is_refused_and_changes_nothing(controller, velocity):
    before = controller.q.copy()
    with pytest.raises(InvalidValueError, match="tip_velocity_in_world"):
        controller.step(velocity, DT)
    np.testing.assert_array_equal(controller.q, before)


def test_bad_period_is_refused(controller):
    with pytest.raises(InvalidValueError, match="dt"):
        controller.step(np.zeros(3), 0.0)


def test_same_requests_give_the_same_bits(tool):
    ends = []
    for _ in range(2):
        controller = RcmController(tool.model, tool.trocar_in_world, RcmControllerConfig())
        controller.reset(tool.home_q)
        for i in range(50):
            controller.step([0.01, 0.02 * np.sin(i), -0.01], DT)
        ends.append(controller.q.copy())
    np.testing.assert_array_equal(*ends)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("max_tip_speed_mps", 0.0),
        ("rcm_feedback", 2.0),
        ("min_insertion_m", -0.1),
        ("max_insertion_m", 0.01),
        ("max_lag_m", np.inf),
    ],
)
def test_bad_configuration_names_the_field(field, value):
    with pytest.raises(InvalidValueError, match=field):
        RcmControllerConfig(**{field: value})


def test_a_copy_and_a_pickle_go_on_to_the_same_bits(controller, tool):
    velocity = np.array([-0.02, 0.03, -0.05])
    controller.set_other_shaft(tool.model.world_from_shaft(tool.home_q) + np.eye(4, k=3) * 0.02, tool.model.shaft)
    for _ in range(30):
        controller.step(velocity, DT)
    copied = pickle.loads(pickle.dumps(copy.deepcopy(controller)))  # noqa: S301  our own bytes
    for _ in range(60):
        for one, other in zip(controller.step(velocity, DT), copied.step(velocity, DT), strict=True):
            np.testing.assert_array_equal(one, other)
        assert controller.last_reason == copied.last_reason
