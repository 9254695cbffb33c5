"""What counts as a limit passed, on a theatre whose state is set by hand."""

from dataclasses import replace

import numpy as np
import pytest

from laploop.assets.tissue_config import TissueConfig, TissueShape
from laploop.control.arm.model import ArmModel
from laploop.control.arm.rcm_config import RcmControllerConfig
from laploop.envs.loop.limit_monitor import LimitMonitor
from laploop.envs.theatre.config import TheatreConfig
from laploop.envs.theatre.theatre import Theatre

CONTROL_S = 0.008
COARSE = TissueConfig(shape=TissueShape(samples=31), cells=(4, 4))


@pytest.fixture(scope="module")
def theatre():
    return Theatre(TheatreConfig(seed=1, tissue=COARSE))


@pytest.fixture
def watch(theatre):
    theatre.reset()
    arms = {"camera": theatre.camera_arm, "tool": theatre.tool_arm}
    models = {name: ArmModel(arm.world_from_base, arm.shaft) for name, arm in arms.items()}
    return LimitMonitor(theatre, models, RcmControllerConfig(), CONTROL_S)


def test_arms_at_home_are_clear_of_everything(theatre, watch):
    watch.period_over()
    home = max(np.abs(theatre.tool_arm.home_q).max(), np.abs(theatre.camera_arm.home_q).max())
    assert watch.worst.joint_position_share >= home / (2.0 * np.pi)
    assert watch.worst.joint_speed_share == 0.0
    assert watch.worst.collision_steps == 0
    assert min(watch.worst.shaft_room_mm, watch.worst.wall_room_mm) > 10.0


def test_a_joint_at_its_limits_of_angle_and_speed_shows(theatre, watch):
    elbow = 2
    theatre.data.qpos[theatre.tool_arm.qpos_indices[elbow]] = -1.01 * np.pi
    theatre.data.qvel[theatre.camera_arm.dof_indices[0]] = 0.5 * np.pi
    theatre.log.reset()
    watch.period_over()
    # The elbow turns by 180 degrees, all others by 360; every joint by 180 degrees a second.
    assert watch.worst.joint_position_share == pytest.approx(1.01)
    assert watch.worst.joint_speed_share == pytest.approx(0.5)


def test_commands_are_measured_against_the_controllers_limits(watch):
    config = RcmControllerConfig()
    step = config.max_joint_acceleration_radps2 * CONTROL_S
    watch.commanded("tool", np.array([step, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert watch.worst.command_acceleration_share == pytest.approx(1.0)
    assert watch.worst.command_speed_share == pytest.approx(step / config.max_joint_speed_radps)
    watch.commanded("tool", np.array([-step, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert watch.worst.command_acceleration_share == pytest.approx(2.0)
    # The other arm has a past of its own.
    watch.commanded("camera", np.full(6, step))
    assert watch.worst.command_acceleration_share == pytest.approx(2.0)


def test_shafts_that_cross_and_a_tip_above_the_wall_show(theatre, watch):
    # The tool's shaft lies level through the scope's, in one of the period's steps.
    theatre.log.tip[2, 1] = theatre.log.tip[2, 0]
    theatre.log.tip[2, 1, 2] = theatre.config.layout.wall_z_m + 0.05
    theatre.log.axis[2, 1] = [1.0, 0.0, 0.0]
    watch.period_over()
    # Axes that meet leave minus both radii, 6 and 2.5 mm; a shaft level with the wall has its tip 50 mm above it.
    assert watch.worst.shaft_room_mm == pytest.approx(-8.5, abs=1e-6)
    assert watch.worst.wall_room_mm == pytest.approx(-50.0, abs=1e-6)


def test_a_touch_of_rigid_bodies_is_counted_and_one_of_the_tissue_is_not(theatre, watch):
    # Straight down through the table.
    theatre.data.qpos[theatre.tool_arm.qpos_indices] = [0.0, 0.6, 0.0, 0.0, 0.0, 0.0]
    theatre.refresh()
    theatre.step()
    watch.period_over()
    assert watch.worst.collision_steps == 1
    theatre.reset()
    # All nodes of the tissue, the last of the positions, up until it covers the tip.
    theatre.data.qpos[2 - 3 * 25 :: 3] += 0.045
    theatre.refresh()
    theatre.step()
    assert np.linalg.norm(theatre.contact_force_in_world()) > 0.0
    watch.period_over()
    assert watch.worst.collision_steps == 1


def test_a_longer_control_period_allows_a_greater_change(theatre):
    arms = {"tool": ArmModel(theatre.tool_arm.world_from_base, theatre.tool_arm.shaft)}
    config = replace(RcmControllerConfig(), max_joint_acceleration_radps2=10.0)
    watch = LimitMonitor(theatre, arms, config, 0.016)
    watch.commanded("tool", np.full(6, 0.16))
    assert watch.worst.command_acceleration_share == pytest.approx(1.0)
