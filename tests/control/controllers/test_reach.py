"""The scripted reach against a sphere in closed form with a spring for contact; the arm is its kinematics alone."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from laploop.assets.shafts import INSTRUMENT
from laploop.control.arm.rcm_controller import RcmController
from laploop.control.controllers.phase import Phase
from laploop.control.controllers.reach import ReachController, ReachControllerConfig
from laploop.control.messages import ControlInput
from laploop.errors import InvalidValueError

TICK_NS = 8_000_000
FRAME_NS = 40_000_000
LATENCY_NS = 40_000_000
STIFFNESS = 300.0  # N/m, what the ball feels of soft tissue
RADIUS = INSTRUMENT.tip_radius_m
MAX_SPEED_MPS = ReachControllerConfig().approach.motion.max_speed_mps


def still(_):
    return 0.0


def breathing_and_beating(time_s):
    return 0.005 * np.sin(2.0 * np.pi * 0.25 * time_s + 0.4) + 0.0005 * np.sin(2.0 * np.pi * 1.2 * time_s)


@dataclass
class Outcome:
    solved_s: float | None = None
    forces: list[float] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)
    phases: list[Phase] = field(default_factory=list)
    commands: list[np.ndarray] = field(default_factory=list)
    tips: list[np.ndarray] = field(default_factory=list)
    rcm_error_m: float = 0.0


class Simulation:
    def __init__(self, rig, tool, sphere, make_frame, world_from_camera, offset=(0.004, 0.003)):
        self.controller = ReachController(rig)
        self.tool, self.sphere, self.make_frame = tool, sphere, make_frame
        self.rotation, self.camera_in_world = world_from_camera[:3, :3], world_from_camera[:3, 3]
        self.pixel = sphere.pixel(sphere.centre[0] + offset[0], sphere.centre[1] + offset[1])
        self.point, self.normal = sphere.surface_at(self.pixel)
        self.trocar = self.in_camera(tool.trocar_in_world)
        self.frames_end_s = np.inf
        self.extra_force = lambda _: 0.0

    def in_camera(self, point_in_world):
        return self.rotation.T @ (point_in_world - self.camera_in_world)

    def run(self, seconds, motion=still, spoil=None):
        arm = RcmController(self.tool.model, self.tool.trocar_in_world)
        arm.reset(self.tool.home_q)
        tip = previous = self.in_camera(self.tool.model.tip_in_world(self.tool.home_q))
        on_the_way, newest, outcome, held = [], None, Outcome(), 0
        for tick in range(round(seconds * 125)):
            now_ns = tick * TICK_NS
            moved = motion(now_ns * 1e-9) - motion(0.0)
            if now_ns % FRAME_NS == 0 and now_ns * 1e-9 < self.frames_end_s:
                depth = self.sphere.depth(moved)
                valid = np.ones(depth.shape, dtype=bool)
                if spoil is not None:
                    depth, valid = spoil(now_ns * 1e-9, depth, valid)
                on_the_way.append(self.make_frame(depth, index=tick, captured_ns=now_ns, latency_ns=LATENCY_NS, valid=valid))
            while on_the_way and on_the_way[0].available_ns <= now_ns:
                newest = on_the_way.pop(0)
            shift = np.array([0.0, 0.0, moved])
            pressed = max(0.0, RADIUS + self.sphere.radius - float(np.linalg.norm(tip - self.sphere.centre - shift)))
            force = STIFFNESS * pressed + self.extra_force(now_ns * 1e-9)
            command = self.controller.command(
                ControlInput(
                    now_ns=now_ns,
                    depth=newest,
                    target_pixel=self.pixel,
                    tip_in_camera=tip.copy(),
                    tip_velocity_in_camera=(tip - previous) / 0.008,
                    trocar_in_camera=self.trocar,
                    contact_force_n=force,
                )
            )
            arm.step(self.rotation @ command, 0.008)
            # Pressed tissue gives way, and the target with it, so that sinking in is no error.
            gap = tip - (self.point + shift + RADIUS * self.normal)
            along = float(gap @ self.normal)
            error = float(np.hypot(np.linalg.norm(gap - along * self.normal), 0.0 if pressed else along))
            held = held + 1 if error < 0.0015 else 0
            if held == 38 and outcome.solved_s is None:
                outcome.solved_s = now_ns * 1e-9
            outcome.errors.append(error)
            outcome.forces.append(force)
            outcome.commands.append(command)
            outcome.tips.append(tip.copy())
            if not outcome.phases or outcome.phases[-1] is not self.controller.phase:
                outcome.phases.append(self.controller.phase)
            outcome.rcm_error_m = max(outcome.rcm_error_m, arm.rcm_error_m)
            # The servos follow with a first-order lag of about 15 ms.
            previous, tip = tip, tip + 0.4 * (self.in_camera(self.tool.model.tip_in_world(arm.q)) - tip)
        return outcome


@pytest.fixture
def simulation(rig, tool, sphere, make_frame, world_from_camera):
    return Simulation(rig, tool, sphere, make_frame, world_from_camera)


def test_still_tissue_is_touched_where_it_was_chosen(simulation):
    outcome = simulation.run(4.0)
    assert outcome.solved_s is not None
    assert outcome.solved_s < 3.0
    assert outcome.errors[-1] < 2e-4  # metres
    assert max(outcome.forces) < 0.3  # newtons
    assert outcome.forces[-1] == pytest.approx(ReachControllerConfig().hold_force_n, abs=0.01)
    assert outcome.phases == [
        Phase.WAIT,
        Phase.TRAVEL,
        Phase.DESCEND,
        Phase.APPROACH,
        Phase.TOUCH,
    ]
    assert outcome.rcm_error_m < 1e-5  # metres


@pytest.mark.parametrize("offset", [(-0.006, 0.004), (0.007, -0.002), (0.0, 0.0)])
def test_breathing_and_beating_tissue_is_touched_and_followed(rig, tool, sphere, make_frame, world_from_camera, offset):
    outcome = Simulation(rig, tool, sphere, make_frame, world_from_camera, offset).run(8.0, breathing_and_beating)
    assert outcome.solved_s is not None
    assert outcome.solved_s < 4.0
    assert max(outcome.forces) < 0.5  # newtons
    assert max(outcome.errors[-500:]) < 1.5e-3  # metres: four seconds, a whole breath, without losing the target


@pytest.mark.parametrize("bias", [-0.0015, 0.0015])
def test_touch_corrects_a_depth_error_along_the_viewing_ray(simulation, bias):
    outcome = simulation.run(4.0, spoil=lambda _, depth, valid: (depth + bias, valid))
    assert outcome.solved_s is not None
    assert outcome.errors[-1] < 3.5e-4  # metres: the slack of 0.25 mm along the normal, and its part along the surface
    assert max(outcome.forces) < 0.4  # newtons


def test_noise_and_outliers_do_not_matter(simulation):
    rng = np.random.default_rng(0)

    def spoil(_, depth, valid):
        depth = depth + 5e-4 * rng.normal(size=depth.shape)
        wrong = rng.random(depth.shape) < 0.2
        depth[wrong] += rng.uniform(-0.01, 0.01, np.count_nonzero(wrong))
        return depth, valid & (rng.random(depth.shape) > 0.1)

    outcome = simulation.run(4.0, breathing_and_beating, spoil)
    assert outcome.solved_s is not None
    assert max(outcome.forces) < 0.5  # newtons


def test_way_to_the_target_stays_above_the_tissue(simulation):
    simulation.sphere.floor = 0.12
    outcome = simulation.run(2.0)
    for tip in outcome.tips:
        from_axis = np.linalg.norm(tip - simulation.sphere.centre) - simulation.sphere.radius
        above_target = float((tip - simulation.point) @ simulation.normal)
        # Wherever the tip is lower than the stand-off, it is over the target's own surroundings.
        assert from_axis > 0.004 or above_target < 0.009


def test_low_tip_rises_before_it_travels(simulation):
    simulation.sphere.floor = simulation.sphere.centre[2]
    tip = simulation.point + np.array([0.03, 0.0, 0.004])
    state = ControlInput(
        now_ns=LATENCY_NS,
        depth=simulation.make_frame(simulation.sphere.depth(), index=0, captured_ns=0),
        target_pixel=simulation.pixel,
        tip_in_camera=tip,
        tip_velocity_in_camera=np.zeros(3),
        trocar_in_camera=simulation.trocar,
        contact_force_n=0.0,
    )
    velocity = simulation.controller.command(state)
    assert simulation.controller.phase is Phase.RISE
    along = velocity / np.linalg.norm(velocity)
    shaft = simulation.trocar - simulation.point
    assert along @ shaft / np.linalg.norm(shaft) > 0.99


def test_without_depth_the_tip_waits(simulation):
    simulation.frames_end_s = 0.0
    outcome = simulation.run(0.5)
    assert not np.any(outcome.commands)
    assert outcome.phases == [Phase.WAIT]


def test_wholly_invalid_depth_is_no_depth(simulation):
    outcome = simulation.run(0.5, spoil=lambda _, depth, valid: (depth, ~valid))
    assert not np.any(outcome.commands)


def test_depth_that_stops_sends_the_tip_farther_than_tissue_moves(simulation):
    simulation.frames_end_s = 2.2
    outcome = simulation.run(5.0)
    assert Phase.TOUCH in outcome.phases
    assert outcome.phases[-1] is Phase.BACK_OFF
    shaft = simulation.trocar - simulation.point
    assert (outcome.tips[-1] - simulation.point) @ shaft / np.linalg.norm(shaft) == pytest.approx(0.016, abs=0.001)  # metres
    np.testing.assert_allclose(outcome.commands[-1], 0.0, atol=1e-4)  # m/s


def test_depth_that_jumps_by_20_mm_for_one_frame_changes_nothing(simulation):
    def spoil(time_s, depth, valid):
        return depth + (0.02 if 1.39 < time_s < 1.42 else 0.0), valid

    outcome = simulation.run(4.0, spoil=spoil)
    assert outcome.solved_s is not None
    assert max(outcome.forces) < 0.3  # newtons


def test_obstacle_on_the_way_makes_the_tool_retreat_and_try_again(simulation):
    simulation.extra_force = lambda time_s: 0.8 if 0.6 < time_s < 0.64 else 0.0
    outcome = simulation.run(6.0)
    assert Phase.RETREAT in outcome.phases
    assert outcome.phases[-1] is Phase.TOUCH
    assert outcome.solved_s is not None


def test_saturated_force_sensor_keeps_the_tool_off(simulation):
    simulation.extra_force = lambda time_s: 50.0 if time_s > 2.2 else 0.0
    outcome = simulation.run(3.5)
    assert outcome.phases[-1] is Phase.STOPPED
    # Above all tissue in view, which begins with the top of the sphere.
    top = simulation.sphere.centre[2] - simulation.sphere.radius
    assert outcome.tips[-1][2] < top - RADIUS - 0.0055  # metres: the clearance of 6 mm, less the noise of its percentile


def test_dead_force_sensor_ends_the_search_a_little_below_the_surface(simulation):
    simulation.extra_force = lambda _: 0.0
    simulation.sphere.radius, radius = simulation.sphere.radius - 0.01, simulation.sphere.radius
    # Frames show the sphere as it was; contact would be felt 10 mm deeper only.
    depth = type(simulation.sphere)(simulation.sphere.rig, radius=radius).depth()
    outcome = simulation.run(4.0, spoil=lambda _, __, valid: (depth, valid))
    ray = simulation.point / np.linalg.norm(simulation.point)
    goal = simulation.point + RADIUS * simulation.normal
    depth_reached = max(float((tip - goal) @ ray) for tip in outcome.tips)
    assert 0.0025 < depth_reached < 0.004  # metres; the search ends after 3 mm


def test_force_that_is_not_a_number_far_from_tissue_makes_the_tool_withdraw_until_it_is_one_again(simulation):
    simulation.extra_force = lambda time_s: np.nan if 0.2 < time_s < 0.4 else 0.0
    outcome = simulation.run(3.5)
    shaft = simulation.trocar - simulation.point
    blind = np.array(outcome.commands[26:49]) @ shaft / np.linalg.norm(shaft)  # 0.2 s to 0.4 s
    np.testing.assert_allclose(blind, 0.5 * MAX_SPEED_MPS, rtol=0.01)  # the ball's radius aside
    assert outcome.solved_s is not None


@pytest.mark.parametrize(("begin", "end"), [(1.0, 1.5), (2.2, 2.6)])
def test_force_that_is_not_a_number_close_to_tissue_makes_the_tool_withdraw(simulation, begin, end):
    simulation.extra_force = lambda time_s: np.nan if begin < time_s < end else 0.0
    outcome = simulation.run(5.0, breathing_and_beating)
    shaft = simulation.trocar - simulation.point
    blind = slice(round(begin * 125) + 1, round(end * 125) - 1)
    out = np.array(outcome.commands[blind]) @ shaft / np.linalg.norm(shaft)
    np.testing.assert_allclose(out, 0.5 * MAX_SPEED_MPS, rtol=0.01)  # the ball's radius aside
    assert outcome.phases[-1] is Phase.TOUCH
    assert outcome.solved_s is not None
    assert np.nanmax(outcome.forces) < 0.3  # newtons


def test_commands_never_exceed_the_speed_limit(simulation):
    outcome = simulation.run(3.0, breathing_and_beating)
    assert np.linalg.norm(outcome.commands, axis=1).max() <= MAX_SPEED_MPS * (1.0 + 1e-9)


def test_reset_starts_over_and_repeats_to_the_bit(simulation):
    first = simulation.run(2.5, breathing_and_beating)
    simulation.controller.reset()
    assert simulation.controller.phase is Phase.WAIT
    assert simulation.controller.target is None
    second = simulation.run(2.5, breathing_and_beating)
    np.testing.assert_array_equal(first.commands, second.commands)


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"contact_force_n": -0.01}, r"contact_force_n is -0\.01; allowed: above 0, at most 10"),
        ({"adaptation_per_s": np.inf}, "adaptation_per_s"),
        ({"hold_force_n": 0.01}, r"hold_force_n is 0\.01; allowed: contact_force_n \(0\.03\) to"),
    ],
)
def test_bad_configuration_is_named(options, name):
    with pytest.raises(InvalidValueError, match=name):
        ReachControllerConfig(**options)
