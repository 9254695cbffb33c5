import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from laploop.assets.tissue_config import TissueConfig, TissueShape
from laploop.envs.sensors.tracing.scene_geometry import SceneGeometry
from laploop.errors import SimulationError
from laploop.studies.scenes.moving_bench import REFERENCE_SEES, SCOPE_SEES, SETTLED_M_S, SPEED_M_S, BenchScene
from laploop.studies.scenes.optical_bench import OpticalBench

BENCH = OpticalBench()


def _pose(height_m, *, yaw=0.0, tilt=0.0, x=0.0):
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("zx", [yaw, tilt]).as_matrix()
    pose[:3, 3] = [x, 0.0, height_m]
    return pose


@pytest.fixture(scope="module")
def scene():
    return BenchScene(
        TissueConfig(shape=TissueShape(samples=31), cells=(4, 4)),
        np.random.default_rng(2),
        world_from_scope=BENCH.world_from_scope,
        scope=BENCH.scope,
        home=lambda height_m: _pose(-height_m),
    )


def test_tissue_follows_the_stage_and_comes_to_rest_there(scene):
    scene.move_stage(_pose(-0.02))
    scene.settle()
    before = scene.surface_points()
    target = _pose(-0.05, yaw=2.0, x=0.015)
    scene.move_stage(target)
    _, speed = scene.settle()
    assert speed < SETTLED_M_S
    expected = (before - [0.0, 0.0, -0.02]) @ target[:3, :3].T + target[:3, 3]
    # A turn about the vertical and a shift leave the sag under its own weight as it is, to a micrometre or two.
    np.testing.assert_allclose(scene.surface_points(), expected, atol=5e-6)


def test_tilt_makes_the_tissue_lean(scene):
    target = _pose(-0.03, tilt=0.17)
    scene.move_stage(_pose(-0.03))
    scene.settle()
    level = scene.surface_points()
    scene.move_stage(target)
    scene.settle()
    rigid = (level - [0.0, 0.0, -0.03]) @ target[:3, :3].T + target[:3, 3]
    lean_m = np.abs(scene.surface_points() - rigid).max()
    assert 1e-5 < lean_m < 2e-3


def test_motion_takes_as_long_as_the_bounded_speed_asks(scene):
    home_z = -scene.mean_height_m
    # A minimum-jerk motion's peak is 1.875 times its mean speed.
    assert scene.move_stage(_pose(home_z - 0.04)) == pytest.approx(1.875 * 0.04 / SPEED_M_S, abs=0.002)
    assert scene.move_stage(_pose(home_z, yaw=1.0)) == pytest.approx(1.875 / (2.0 * np.pi), abs=0.002)


def test_motion_does_not_depend_on_those_before_it(scene):
    target = _pose(-0.04, yaw=-1.0, tilt=0.1)
    scene.move_stage(target)
    scene.settle()
    once = scene.surface_points()
    scene.move_stage(_pose(0.02, yaw=3.0, tilt=-0.1))
    scene.place_tool(np.array([0.0, 0.0, 0.03]), np.array([0.0, 0.6, -0.8]))
    scene.move_stage(target)
    scene.settle()
    np.testing.assert_array_equal(scene.surface_points(), once)


def test_tissue_that_is_not_still_in_time_is_an_error(scene):
    scene.move_stage(_pose(-0.04))
    with pytest.raises(SimulationError, match=r"still moves at .* allowed: below 0\.1 mm/s"):
        scene.settle(limit_s=0.004)


@pytest.mark.parametrize("spoilt", ["mocap_pos", "qvel"])
def test_invalid_physics_is_an_error(scene, spoilt):
    scene.move_stage(_pose(-0.04))
    getattr(scene.data, spoilt)[:] = np.nan
    with pytest.raises(SimulationError, match="became invalid"):
        scene.settle()
    # The next motion starts from a sound state.
    scene.move_stage(_pose(-0.04))
    scene.settle()


def test_reference_camera_sees_the_scope_that_the_scope_does_not_see(scene):
    scene.move_stage(_pose(-0.03))
    mujoco.mj_forward(scene.model, scene.data)
    highest = {}
    for name, groups in (("scope", SCOPE_SEES), ("reference", REFERENCE_SEES)):
        geometry = SceneGeometry.from_model(scene.model, groups=groups)
        geometry.update(scene.data)
        near = np.abs(geometry.points[:, :2]).max(axis=1) < 0.1
        highest[name] = geometry.points[near, 2].max()
    assert highest["scope"] < 0.03
    assert highest["reference"] > 0.3
    shaft = scene.model.geom("scope/shaft")
    lowest = scene.data.geom_xpos[shaft.id] - shaft.size[1] * scene.data.geom_xmat[shaft.id].reshape(3, 3)[:, 2]
    other = scene.data.geom_xpos[shaft.id] + shaft.size[1] * scene.data.geom_xmat[shaft.id].reshape(3, 3)[:, 2]
    tip = min(lowest, other, key=lambda point: point[2])
    np.testing.assert_allclose(tip, [0.5 * BENCH.scope.baseline_m, 0.0, BENCH.nominal_distance_m], atol=1e-9)
