"""The stage moves what rests on it, and contacts see how fast."""

import mujoco
import numpy as np
import pytest

from laploop.control.arm.model import ArmModel
from laploop.envs.theatre.config import TheatreConfig
from laploop.envs.theatre.organ_motion import BaseMotion, StageTravel
from laploop.envs.theatre.theatre import Theatre

MOVING = TheatreConfig(
    seed=3, motion=BaseMotion.named("both"), travel=StageTravel(x_peak_to_peak_m=0.02, y_peak_to_peak_m=0.02)
)


def test_plate_and_phantom_are_where_the_motion_has_them():
    theatre = Theatre(MOVING)
    for _ in range(30):
        theatre.step()
    expected = theatre.stage.position(theatre.now_ns)
    for name in ("stage/plate", "phantom/phantom"):
        np.testing.assert_allclose(theatre.data.body(name).xpos, expected, atol=1e-15)


def test_contacts_see_the_velocity_with_which_the_stage_goes_on():
    theatre = Theatre(MOVING)
    step_s = theatre.rates.physics_s
    for _ in range(5):
        theatre.step()
        body = theatre.data.body("tool_arm/instrument/contact")
        seen = body.xmat.reshape(3, 3) @ [theatre.data.joint(f"tool_arm/instrument/contact_{axis}").qvel[0] for axis in "xyz"]
        now_ns = theatre.now_ns
        velocity = (theatre.stage.position(now_ns + round(step_s * 1e9)) - theatre.stage.position(now_ns)) / step_s
        # m/s: the frame in which the joints move is a step old.
        np.testing.assert_allclose(seen, -velocity, atol=1e-6)
        # The contact body itself stays on the tip.
        np.testing.assert_allclose(body.xpos, theatre.data.body("tool_arm/instrument/tip").xpos, atol=1e-15)


def pressed(theatre, depth_m):
    """Lower the tip vertically through its trocar's plane until the tissue is pressed by that much; return the joints."""
    arm = theatre.tool_arm
    model = ArmModel(arm.world_from_base, arm.shaft)
    q = arm.home_q.copy()
    points = theatre.tissue.surface_points()[: theatre.tissue.top_vertex_count]
    tip = theatre.tip_in_world()
    surface = points[np.linalg.norm(points[:, :2] - tip[:2], axis=1).argmin(), 2]
    way = tip[2] - arm.shaft.tip_radius_m - surface + depth_m
    steps = 200
    for _ in range(steps):
        down = np.zeros(6)
        down[2] = -way / steps
        q = q + np.linalg.pinv(model.tip_jacobian(q)) @ down
        theatre.set_joint_targets(arm, q, None)
        for _ in range(theatre.rates.physics_steps_per_control):
            theatre.step()
    # The tissue creeps until it rests.
    for _ in range(200):
        theatre.step()
    return q


@pytest.mark.parametrize("hertz", [0.25, 1.2])
def test_a_tip_that_rides_on_receding_tissue_stays_in_touch(hertz):
    # The tip goes down with the stage, as a controller would have it that knows the motion.
    theatre = Theatre(TheatreConfig(seed=3))
    arm, model = theatre.tool_arm, ArmModel(theatre.tool_arm.world_from_base, theatre.tool_arm.shaft)
    q = pressed(theatre, 0.001)
    held = np.linalg.norm(theatre.contact_force_in_world())
    assert held > 0.02
    middle, start_ns = theatre.stage._middle.copy(), theatre.now_ns
    sway = 0.001 * 0.25 / hertz

    def lowered(now_ns):
        return sway * (np.cos(2.0 * np.pi * hertz * (now_ns - start_ns) * 1e-9) - 1.0)

    theatre.stage.position = lambda now_ns: middle + [0.0, 0.0, lowered(now_ns)]
    forces, period_ns = [], theatre.rates.control_ns
    for _ in range(round(0.5e9 / hertz / period_ns)):
        move = np.zeros(6)
        move[2] = lowered(theatre.now_ns + period_ns) - lowered(theatre.now_ns)
        step = np.linalg.pinv(model.tip_jacobian(q)) @ move
        theatre.set_joint_targets(arm, q, step / (period_ns * 1e-9))
        q = q + step
        for _ in range(theatre.rates.physics_steps_per_control):
            theatre.step()
            forces.append(np.linalg.norm(theatre.contact_force_in_world()))
    assert min(forces) > 0.7 * held
    assert max(forces) < 1.3 * held


def test_the_surface_hangs_on_the_lattice_as_the_flex_does():
    theatre = Theatre(MOVING)
    pressed(theatre, 0.002)
    mujoco.mj_flex(theatre.model, theatre.data)
    top = theatre.tissue.top_vertex_count
    surface = theatre.tissue.surface_points()
    # The solid's vertices are those of its bottom, then every sample of its top.
    # Metres: rounding alone.
    np.testing.assert_allclose(surface[:top], theatre.data.flexvert_xpos[-top:], atol=1e-15)
    rows = np.array([[0, 7], [top - 1, top + 3]])
    np.testing.assert_array_equal(theatre.tissue[rows], surface[rows])
