"""What the controllers do when something fails: the tip never presses with 2 N, and where it ends up is known."""

import numpy as np
import pytest

from laploop.control.controllers.palpate import PalpateController
from laploop.control.controllers.reach import ReachController
from laploop.control.controllers.track import TrackController

CONTROLLERS = [ReachController, TrackController, PalpateController]
MOST_N = 2.0


@pytest.fixture(params=CONTROLLERS, ids=lambda cls: cls.__name__)
def controller(request, rig):
    return request.param(rig)


@pytest.fixture
def plant(make_plant, breathing):
    plant = make_plant()
    plant.motion = breathing
    return plant


def works(phase):
    return phase in {"touch", "hold"}


@pytest.mark.parametrize("stops_s", [1.0, 2.0, 4.0])
def test_perception_that_stops_sends_the_tool_back_to_a_standoff(controller, plant, stops_s):
    plant.spoil = lambda time_s, depth, valid: None if time_s >= stops_s else (depth, valid)
    log = plant.run(controller, 9.0)
    assert max(log.forces) < MOST_N
    assert log.phases[-1] == "back-off"
    last = np.array(log.commands[-60:])
    assert np.linalg.norm(last, axis=1).max() < 1e-3  # m/s: it waits


def test_perception_that_comes_back_lets_the_task_go_on(controller, plant):
    plant.spoil = lambda time_s, depth, valid: None if 3.0 <= time_s < 5.0 else (depth, valid)
    log = plant.run(controller, 12.0)
    assert max(log.forces) < MOST_N
    assert works(log.phases[-1])


@pytest.mark.parametrize("jump_m", [-0.02, 0.02])
def test_depth_that_jumps_for_one_frame_is_rejected(controller, plant, jump_m):
    def spoil(time_s, depth, valid):
        return depth + (jump_m if abs(time_s - 4.0) < 0.01 else 0.0), valid

    plant.motion = lambda _: 0.0
    clean = plant.run(controller, 6.0)
    plant.spoil = spoil
    controller.reset()
    log = plant.run(controller, 6.0)
    # A rejected frame counts as one that never came: on still tissue that makes no difference.
    np.testing.assert_allclose(log.tips, clean.tips, atol=1e-5)  # metres


def test_depth_that_is_all_invalid_from_the_start_moves_nothing(controller, plant):
    plant.spoil = lambda _, depth, valid: (depth, np.zeros_like(valid))
    log = plant.run(controller, 2.0)
    assert not np.any(log.commands)


def test_depth_that_becomes_invalid_counts_as_perception_that_stops(controller, plant):
    plant.spoil = lambda time_s, depth, valid: (depth, valid & (time_s < 4.0))
    log = plant.run(controller, 8.0)
    assert max(log.forces) < MOST_N
    assert not works(log.phases[-1])


def test_depth_that_is_not_a_number_counts_as_invalid(controller, plant):
    def spoil(time_s, depth, valid):
        return np.where(time_s < 4.0, depth, np.nan), valid

    plant.spoil = spoil
    log = plant.run(controller, 8.0)
    assert max(log.forces) < MOST_N
    assert not works(log.phases[-1])


def test_frames_out_of_order_are_ignored(controller, plant, make_frame):
    class Shuffled:
        """Shows every other frame again after a newer one."""

        def __init__(self, inner):
            self.inner, self.frames = inner, []
            self.phase = ""

        def command(self, state):
            frame = state.depth
            if frame is not None and (not self.frames or frame is not self.frames[-1]):
                self.frames.append(frame)
            stale = self.frames[-5] if len(self.frames) > 5 and state.now_ns // 8_000_000 % 2 else frame
            command = self.inner.command(_with_depth(state, stale))
            self.phase = self.inner.phase
            return command

    clean = plant.run(controller, 6.0)
    controller.reset()
    log = plant.run(Shuffled(controller), 6.0)
    # Frames are seen one tick later at worst.
    assert max(log.forces) < max(clean.forces) + 0.1
    assert works(log.phases[-1])


def _with_depth(state, depth):
    return type(state)(**(vars(state) | {"depth": depth}))


def test_target_that_leaves_the_view_sends_the_tool_back(controller, plant):
    def spoil(time_s, depth, valid):
        # What the camera would show if the tissue slid out of its view: nothing where the target was.
        seen = valid.copy()
        if time_s > 4.0:
            seen[60:190, 60:220] = False
        return depth, seen

    plant.spoil = spoil
    log = plant.run(controller, 8.0)
    assert max(log.forces) < MOST_N
    assert not works(log.phases[-1])


def test_tissue_out_of_reach_leaves_the_tool_at_the_arms_limit(controller, plant):
    plant.limit = lambda velocity, tip: np.where(tip[2] + 0.008 * velocity[2] > 0.08, 0.0, velocity)
    log = plant.run(controller, 9.0)
    assert max(log.forces) == 0.0
    assert log.tips[-1][2] <= 0.0805  # metres
    assert log.phases[-1] == "unreachable"
    np.testing.assert_array_equal(log.commands[-1], np.zeros(3))


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 60.0])
@pytest.mark.parametrize("begin_s", [1.5, 3.0, 5.0])
def test_force_sensor_that_fails_for_good_keeps_the_tool_off(controller, plant, wrong, begin_s):
    plant.sensor = lambda time_s, force: wrong if time_s > begin_s else force
    plant.limit = lambda velocity, tip: velocity if tip[2] > 0.03 or velocity[2] > 0.0 else np.zeros(3)
    log = plant.run(controller, 8.0)
    assert max(log.forces) < MOST_N
    assert not works(log.phases[-1])


def test_tip_position_that_is_not_a_number_makes_the_tool_withdraw(controller, plant):
    class Blinded:
        phase = ""

        def command(self, state):
            if 4.0 < state.now_ns * 1e-9 < 4.3:
                state = type(state)(**(vars(state) | {"tip_in_camera": np.full(3, np.nan)}))
            command = controller.command(state)
            self.phase = controller.phase
            return command

    log = plant.run(Blinded(), 10.0)
    assert max(log.forces) < MOST_N
    assert "retreat" in log.phases
    assert works(log.phases[-1])
