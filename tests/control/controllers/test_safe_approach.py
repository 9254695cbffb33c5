"""The way to a stand-off and back, for a target at rest; the tip integrates its velocity."""

from dataclasses import replace

import numpy as np
import pytest

from laploop.control.controllers.approach_geometry import ApproachGeometry
from laploop.control.controllers.phase import Phase
from laploop.control.controllers.safe_approach import SafeApproach, SafeApproachConfig
from laploop.control.messages import ControlInput
from laploop.control.targeting.targeting import Target

TICK_NS = 8_000_000
CONFIG = SafeApproachConfig()
HALF_SPEED = 0.5 * CONFIG.motion.max_speed_mps
TROCAR = np.array([0.17, 0.0, -0.11])
TARGET = Target(
    point=np.array([0.004, 0.002, 0.1]),
    normal=np.array([0.0, 0.0, -1.0]),
    velocity=np.zeros(3),
    nearest_depth=0.09,
    captured_ns=0,
)


class Flight:
    """A tip on its way, with a force sensor and a target that can be changed between ticks."""

    def __init__(self, tip=(0.03, -0.01, 0.05)):
        self.approach = SafeApproach()
        self.tip, self.now_ns = np.array(tip), 0
        self.force, self.contact, self.captured_ns = 0.0, False, None
        self.target, self.stuck, self.phases = TARGET, False, []

    def tick(self):
        """Return the velocity or the geometry of a tick, and move the tip."""
        seen_ns = self.now_ns if self.captured_ns is None else self.captured_ns
        target = None if self.target is None else replace(self.target, captured_ns=seen_ns)
        state = ControlInput(
            now_ns=self.now_ns,
            depth=None,
            target_pixel=np.zeros(2),
            tip_in_camera=self.tip.copy(),
            tip_velocity_in_camera=np.zeros(3),
            trocar_in_camera=TROCAR,
            contact_force_n=self.force,
        )
        way = self.approach.advance(state, target, contact=self.contact)
        if not isinstance(way, ApproachGeometry):
            assert np.linalg.norm(way) <= CONFIG.motion.max_speed_mps * (1.0 + 1e-9)
            self.tip = self.tip + (0.0 if self.stuck else 1e-9 * TICK_NS) * way
        self.now_ns += TICK_NS
        if not self.phases or self.phases[-1] is not self.approach.phase:
            self.phases.append(self.approach.phase)
        return way

    def until(self, phase, seconds=8.0):
        """Run to the first tick of a phase; return what that tick gave."""
        for _ in range(round(seconds * 125)):
            way = self.tick()
            if self.approach.phase is phase:
                return way
        raise AssertionError(f"{phase} was not reached in {seconds} s; phases were {self.phases}")

    def run(self, seconds):
        for _ in range(round(seconds * 125)):
            way = self.tick()
        return way


@pytest.fixture
def flight():
    return Flight()


@pytest.fixture
def ready():
    flight = Flight()
    flight.until(Phase.READY)
    return flight


def out_of(flight):
    """Return the unit vector from the target's goal to the trocar."""
    goal = TARGET.point + CONFIG.distances.shaft.tip_radius_m * TARGET.normal
    return (TROCAR - goal) / np.linalg.norm(TROCAR - goal)


def test_without_a_target_the_tip_waits(flight):
    flight.target = None
    np.testing.assert_array_equal(flight.run(0.5), np.zeros(3))
    assert flight.phases == [Phase.WAIT]


def test_legs_lead_to_the_stand_off_and_then_the_task_may_work(flight):
    flight.tip = np.array([0.03, -0.01, 0.095])
    geometry = flight.until(Phase.READY)
    assert flight.phases == [Phase.RISE, Phase.TRAVEL, Phase.DESCEND, Phase.READY]
    assert np.linalg.norm(geometry.standoff - flight.tip) < 0.002  # metres
    assert isinstance(flight.tick(), ApproachGeometry)


def test_a_bump_on_the_way_makes_the_next_attempt_come_down_along_the_shaft(flight):
    flight.until(Phase.DESCEND)
    flight.force = CONFIG.bump_force_n
    np.testing.assert_allclose(flight.until(Phase.RETREAT), HALF_SPEED * out_of(flight), rtol=1e-6)
    flight.force = 0.0
    began_ns = flight.now_ns
    flight.until(Phase.TRAVEL)
    assert flight.now_ns - began_ns >= CONFIG.retreat_s * 1e9
    geometry = flight.until(Phase.READY)
    np.testing.assert_array_equal(geometry.axis, geometry.shaft)


def test_a_retreat_lasts_as_long_as_something_is_felt(ready):
    ready.force = CONFIG.bump_force_n
    ready.until(Phase.RETREAT)
    ready.force = CONFIG.clear_force_n
    ready.run(1.0)
    assert ready.approach.phase is Phase.RETREAT


def test_work_in_contact_may_press_up_to_the_withdrawal_and_other_work_may_not(ready):
    ready.contact, ready.force = True, 1.19
    assert isinstance(ready.tick(), ApproachGeometry)
    ready.force = CONFIG.withdraw_force_n
    ready.tick()
    assert ready.approach.phase is Phase.RETREAT
    hover = Flight()
    hover.until(Phase.READY)
    hover.force = CONFIG.bump_force_n
    hover.tick()
    assert hover.approach.phase is Phase.RETREAT


def test_the_alarm_stays_up_until_reset(ready):
    ready.force = 1.99
    ready.tick()
    assert not ready.approach.alarm
    ready.force = 2.0
    ready.tick()
    ready.force = 0.0
    ready.run(1.0)
    assert ready.approach.alarm
    ready.approach.reset()
    assert not ready.approach.alarm


def test_a_force_that_must_not_be_ends_the_task_above_all_tissue(ready):
    ready.force = CONFIG.stop_force_n
    ready.until(Phase.STOPPED)
    ready.force = 0.0
    np.testing.assert_array_equal(ready.run(3.0), np.zeros(3))
    assert ready.approach.phase is Phase.STOPPED
    assert ready.tip[2] < TARGET.nearest_depth - CONFIG.distances.clearance_m


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_a_reading_that_is_no_number_makes_the_tool_withdraw_along_the_last_known_way(ready, wrong):
    ready.force = wrong
    np.testing.assert_allclose(ready.tick(), HALF_SPEED * out_of(ready), rtol=1e-6)
    assert ready.approach.phase is Phase.RETREAT
    ready.force = 0.0
    ready.until(Phase.READY)


def test_a_tip_that_is_no_number_before_any_target_moves_nothing(flight):
    flight.target, flight.tip = None, np.full(3, np.nan)
    np.testing.assert_array_equal(flight.tick(), np.zeros(3))
    assert flight.approach.phase is Phase.WAIT


def test_a_lost_target_sends_the_tool_back_and_a_found_one_brings_it_down_again(ready):
    ready.captured_ns = ready.now_ns
    ready.until(Phase.BACK_OFF, 1.0)
    assert ready.now_ns - ready.captured_ns > CONFIG.max_age_s * 1e9
    np.testing.assert_allclose(ready.run(3.0), 0.0, atol=1e-4)  # m/s: it waits
    goal = TARGET.point + CONFIG.distances.shaft.tip_radius_m * TARGET.normal
    np.testing.assert_allclose(ready.tip, goal + CONFIG.lost_standoff_m * out_of(ready), atol=1e-4)  # metres
    ready.captured_ns = None
    ready.until(Phase.READY)


def test_no_progress_for_too_long_is_unreachable(flight):
    flight.until(Phase.TRAVEL)
    flight.stuck = True
    began_ns = flight.now_ns
    np.testing.assert_array_equal(flight.until(Phase.UNREACHABLE), np.zeros(3))
    assert (flight.now_ns - began_ns) * 1e-9 == pytest.approx(CONFIG.patience_s, abs=0.02)  # seconds: two ticks


def test_giving_an_attempt_up_leads_out_at_once(ready):
    state = ControlInput(
        now_ns=ready.now_ns,
        depth=None,
        target_pixel=np.zeros(2),
        tip_in_camera=ready.tip,
        tip_velocity_in_camera=np.zeros(3),
        trocar_in_camera=TROCAR,
        contact_force_n=0.0,
    )
    np.testing.assert_allclose(ready.approach.withdraw(state), HALF_SPEED * out_of(ready), rtol=1e-6)
    assert ready.approach.phase is Phase.RETREAT
