"""The theatre as it stands: everything in its place, at rest, free of contact."""

import mujoco
import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.control.arm.model import ArmModel
from laploop.envs.theatre.actuation import ActuationConfig
from laploop.envs.theatre.config import TheatreConfig, TheatreLayout
from laploop.envs.theatre.organ_motion import BaseMotion
from laploop.envs.theatre.theatre import Theatre
from laploop.errors import InvalidValueError, SimulationError


@pytest.fixture(scope="module")
def theatre():
    return Theatre(TheatreConfig(seed=3))


@pytest.mark.parametrize("seed", range(20))
def test_every_seed_starts_through_the_trocars_without_contact(seed):
    theatre = Theatre(TheatreConfig(seed=seed))
    theatre.refresh()
    for arm in theatre.arms:
        # Metres: the start postures are solved to 1e-9.
        assert theatre.rcm_error_m(arm) < 1e-6
    assert theatre.data.ncon == 0
    surface = theatre.tissue.surface_points()[: theatre.tissue.top_vertex_count]
    mean_distance = theatre.world_from_camera()[2, 3] - surface[:, 2].mean()
    assert 0.070 < mean_distance < 0.110
    height = theatre.tip_in_world()[2] - surface[:, 2].mean()
    assert 0.020 < height < 0.045
    for _ in range(5):
        theatre.step()
    assert theatre.data.ncon == 0
    assert np.abs(theatre.data.qvel).max() < 1e-4


def test_scope_looks_straight_down_with_the_projector_to_its_right(theatre):
    theatre.refresh()
    camera, projector = theatre.world_from_camera(), theatre.world_from_projector()
    # Radians and metres: the start posture's tolerance.
    np.testing.assert_allclose(camera[:3, :3], np.diag([1.0, -1.0, -1.0]), atol=1e-8)
    baseline = ScopeOptics().baseline_m
    np.testing.assert_allclose(np.linalg.inv(camera) @ projector[:, 3], [baseline, 0.0, 0.0, 1.0], atol=1e-8)


def test_mujocos_camera_stands_where_the_channel_is(theatre):
    theatre.refresh()
    pose = theatre.world_from_camera()
    camera = theatre.data.cam("camera_arm/scope/camera")
    np.testing.assert_allclose(camera.xpos, pose[:3, 3], atol=1e-12)
    np.testing.assert_allclose(camera.xmat.reshape(3, 3) @ np.diag([1.0, -1.0, -1.0]), pose[:3, :3], atol=1e-12)


def test_pinocchio_sees_both_shafts_where_the_simulator_has_them(theatre):
    rng = np.random.default_rng(0)
    qpos = theatre.data.qpos.copy()
    for arm in theatre.arms:
        model = ArmModel(arm.world_from_base, arm.shaft)
        for _ in range(50):
            q = rng.uniform(-np.pi, np.pi, 6)
            theatre.data.qpos[arm.qpos_indices] = q
            theatre.refresh()
            # Metres and direction cosines; two implementations of the same chain.
            np.testing.assert_allclose(theatre.world_from_shaft(arm), model.world_from_shaft(q), rtol=0.0, atol=1e-9)
    theatre.data.qpos[:] = qpos
    theatre.refresh()


def test_tool_is_the_only_arm_that_the_endoscope_can_see(theatre):
    model = theatre.model
    visible = {model.geom(index).name for index in np.flatnonzero(model.geom_group == 1)}
    assert visible == {"tool_arm/instrument/shaft", "tool_arm/instrument/tip", "tool_arm/instrument/taper", "stage/plate"}
    assert model.flex_group[0] == 1


def test_working_distance_is_as_asked():
    theatre = Theatre(TheatreConfig(seed=0, working_distance_m=0.085))
    surface = theatre.tissue.surface_points()[: theatre.tissue.top_vertex_count]
    # Metres: the tissue settles a little below the shape it was cut to.
    np.testing.assert_allclose(theatre.world_from_camera()[2, 3] - surface[:, 2].mean(), 0.085, atol=5e-4)


def test_normals_of_the_tissue_point_away_from_it(theatre):
    corners = theatre.tissue.surface_points()[theatre.tissue.top_triangles]
    assert np.all(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 0.0)


def test_surface_moves_with_the_stage_by_the_breathing_amplitude():
    motion = BaseMotion(breathing_peak_to_peak_m=0.010, breathing_hz=1.0)
    theatre = Theatre(TheatreConfig(seed=0, motion=motion))
    start, heights, displacements = theatre.tissue.surface_points()[:, 2].copy(), [], []
    for _ in range(500):
        theatre.step()
        theatre.refresh()
        heights.append(theatre.tissue.surface_points()[:, 2] - start)
        displacements.append(theatre.motion.displacement(theatre.now_ns * 1e-9) - theatre.motion.displacement(0.0))
    # Metres, at every vertex: what elasticity adds to 5 mm at 1 Hz.
    np.testing.assert_allclose(np.ptp(heights, axis=0), 0.010, atol=1e-4)
    # A positive displacement is one towards the scope; soft tissue lags its stage by a few milliseconds of 31 mm/s.
    np.testing.assert_allclose(np.mean(heights, axis=1), displacements, atol=3e-4)


def test_reset_brings_back_the_same_bits(theatre):
    theatre.reset()
    start = theatre.data.qpos.copy()
    theatre.set_joint_targets(theatre.tool_arm, theatre.tool_arm.home_q + 0.01)
    for _ in range(20):
        theatre.step()
    assert theatre.now_ns == 20 * 2_000_000
    theatre.reset()
    assert theatre.now_ns == 0
    np.testing.assert_array_equal(theatre.data.qpos, start)
    assert not theatre.data.qvel.any()


def test_invalid_state_stops_the_simulation(tmp_path, monkeypatch):
    # MuJoCo writes a log file into the working folder when it warns.
    monkeypatch.chdir(tmp_path)
    theatre = Theatre(TheatreConfig(seed=0))
    theatre.data.qvel[0] = np.nan
    with pytest.raises(SimulationError, match="BADQ"):
        theatre.step()


def test_targets_that_are_not_six_finite_numbers_are_refused(theatre):
    home = theatre.tool_arm.home_q
    for bad in (home[:5], np.full(6, np.nan)):
        with pytest.raises(InvalidValueError, match="q is"):
            theatre.set_joint_targets(theatre.tool_arm, bad)
    with pytest.raises(InvalidValueError, match="qdot is"):
        theatre.set_joint_targets(theatre.tool_arm, home, np.zeros(3))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("seed", -1),
        ("seed", 1.5),
        ("seed", True),
        ("working_distance_m", 0.5),
    ],
)
def test_impossible_configs_are_refused(field, value):
    with pytest.raises(InvalidValueError, match=field):
        TheatreConfig(**{"seed": 0, field: value})


def test_impossible_layouts_are_refused():
    with pytest.raises(InvalidValueError, match="scope_tip_z_m"):
        TheatreLayout(wall_z_m=0.2)
    with pytest.raises(InvalidValueError, match="tool_trocar_x_m"):
        TheatreLayout(tool_trocar_x_m=0.0)


def test_arms_know_their_own_numbers(theatre):
    model = theatre.model
    for arm in theatre.arms:
        assert model.joint(f"{arm.name}/wrist_3_joint").qposadr[0] == arm.qpos_indices[5]
        assert mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_ACTUATOR, arm.actuator_indices[0]).startswith(f"{arm.name}/")
        with pytest.raises(ValueError, match="read-only"):
            arm.home_q[0] = 0.0


def test_the_state_of_a_theatre_on_the_move_goes_on_to_the_same_bits_in_another_of_its_seed():
    config = TheatreConfig(seed=3, motion=BaseMotion.named("both"), actuation=ActuationConfig.named("ur5-cb"))
    theatre, other = Theatre(config), Theatre(config)

    def press(one, steps):
        for step in range(steps):
            if step % 4 == 0:
                one.set_joint_targets(one.tool_arm, one.joint_positions(one.tool_arm), np.full(6, 0.05))
            one.step()
        return [one.data.qpos.copy(), one.data.qvel.copy(), one.log.tip.copy(), [one.port_force_n(arm) for arm in one.arms]]

    press(theatre, 100)
    state = theatre.get_state()
    press(other, 30)
    other.set_state(state)
    expected = press(theatre, 60)
    np.testing.assert_equal(press(other, 60), expected)
    assert other.now_ns == theatre.now_ns
    theatre.set_state(state)
    np.testing.assert_equal(press(theatre, 60), expected)
