"""A user's closed surface as tissue: at rest, seen, touched, and in its place, as the built-in one is."""

import numpy as np
import pytest
import trimesh

from laploop.assets.phantom_import.phantom_mesh import load_phantom
from laploop.assets.tissue_config import TissueConfig, TissueShape
from laploop.assets.tissue_mesh import mean_top_height, solid_from_tetrahedra, solid_mesh
from laploop.assets.tissue_shape import height_field
from laploop.control.arm.model import ArmModel
from laploop.control.arm.start_posture import start_posture
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.envs.theatre.config import TheatreConfig
from laploop.envs.theatre.theatre import Theatre
from laploop.errors import InvalidValueError
from laploop.perception.geometry import Rig


def bumpy_dome():
    """Return a dome of 110x110x28 mm with bumps of 1.5 mm and a flat underside."""
    mesh = trimesh.creation.icosphere(subdivisions=3)
    x, y, z = mesh.vertices.T
    bumps = 1.5 / 28.0 * np.sin(55.0 * x / 6.0) * np.cos(55.0 * y / 7.0)
    mesh.vertices[:, 2] = np.where(z > 0.0, z * (1.0 + bumps), 0.0)
    mesh.apply_scale((55.0, 55.0, 28.0))
    return mesh


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    folder = tmp_path_factory.mktemp("phantom")
    bumpy_dome().export(folder / "dome.stl")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(folder))
        yield folder / "dome.stl"


@pytest.fixture(scope="module")
def solid(path):
    return load_phantom(path)


@pytest.fixture(scope="module")
def config(path):
    return TheatreConfig(seed=0, working_distance_m=0.085, tissue=TissueConfig(mesh=path))


def test_phantom_is_at_the_working_distance_and_hardly_sags(config, solid):
    theatre = Theatre(config)
    theatre.refresh()
    points = theatre.tissue.surface_points()
    rest = solid.surface_points + [0.0, 0.0, 0.2 - 0.085 - mean_top_height(solid)]
    # Metres: its weight of 2 N presses on 10 kPa; the camera stands where the start posture's tolerance allows.
    assert np.abs(points - rest).max() < 0.001
    assert theatre.data.ncon == 0
    corners = points[theatre.tissue.top_triangles]
    # All but some at the steep rim, which its weight tips over.
    assert np.mean(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 0.0) > 0.99
    assert theatre.tissue.top_vertex_count == theatre.tissue.top_triangles.max() + 1


def test_it_stays_at_rest_for_two_seconds_without_a_warning(config):
    theatre = Theatre(config)
    for _ in range(1000):
        # `step` raises on any warning.
        theatre.step()
    # m/s: slower than any sensor could see.
    assert np.abs(theatre.data.qvel).max() < 1e-5


def test_camera_sees_tissue_with_smooth_normals_in_the_middle(config):
    theatre = Theatre(config)
    theatre.refresh()
    rig = Rig.from_optics(config.scope)
    camera = StripeCamera(rig, StripeOptics())
    camera.attach(theatre.model, tissue=theatre.tissue)
    capture = camera.capture(theatre.data, theatre.world_from_camera(), np.random.default_rng(0))
    middle = (slice(64, 192), slice(64, 192))
    assert np.all(capture.object_id[middle][capture.object_id[middle] != ObjectId.TOOL] == ObjectId.TISSUE)
    tissue = (capture.object_id[middle] == ObjectId.TISSUE)[:, 1:] & (capture.object_id[middle] == ObjectId.TISSUE)[:, :-1]
    normals = capture.normals[middle].astype(np.float64)
    bend = np.degrees(np.arccos(np.clip(np.sum(normals[:, 1:] * normals[:, :-1], axis=-1), -1.0, 1.0)))[tissue]
    # Degrees from one pixel to the next, 0.4 mm: flat facets of 3 mm would jump by five and more at every edge.
    assert np.quantile(bend, 0.99) < 4.0
    # Millimetres: the dome's crest is nearer than its mean height.
    assert 60.0 < np.nanmin(capture.depth_mm[middle]) < 90.0


def test_force_grows_with_depth(config):
    theatre = Theatre(config)
    theatre.refresh()
    points = theatre.tissue.surface_points()
    touch = points[np.argmin(np.hypot(points[:, 0], points[:, 1]))] + [0.0, 0.0, theatre.tool_arm.shaft.tip_radius_m]
    arm = theatre.tool_arm
    model = ArmModel(arm.world_from_base, arm.shaft)
    start = theatre.tip_in_world()
    above = start + np.linspace(0.0, 1.0, 60)[:, None] * (touch + [0.0, 0.0, 0.002] - start)
    tips = np.concatenate([above, touch + np.linspace(0.002, -0.003, 80)[:, None] * [0.0, 0.0, 1.0]])
    q, forces = arm.home_q, []
    for tip in tips:
        z = (tip - arm.trocar_in_world) / np.linalg.norm(tip - arm.trocar_in_world)
        y = np.cross(z, [0.0, 1.0, 0.0])
        y /= np.linalg.norm(y)
        pose = np.eye(4)
        pose[:3] = np.column_stack([np.cross(y, z), y, z, tip])
        q = start_posture(model, pose, q)
        theatre.set_joint_targets(arm, q, None)
        for _ in range(theatre.rates.physics_steps_per_control):
            theatre.step()
        forces.append(theatre.contact_force_in_world()[2])
    forces = np.array(forces)
    assert not forces[:60].any()
    # Newtons: soft tissue under a probe of 1.5 mm radius, 3 mm deep; the built-in phantom gives 0.3 to 1.5.
    assert 0.2 < forces[-1] < 2.0
    assert forces[-1] > forces[-20] > forces[-35]


def test_built_in_tissue_is_what_it_was_without_a_solid():
    shape = TissueShape()
    rng = np.random.default_rng(5).spawn(2)[0]
    mesh = solid_mesh(shape, height_field(shape, rng))
    theatre = Theatre(TheatreConfig(seed=5, working_distance_m=0.09))
    theatre.refresh()
    # All upper nodes are free: 2 arms of 6 joints, 11x11 nodes of 3; the contact body has 3.
    assert theatre.model.nv == 12 + 3 * 121 + 3
    assert len(theatre.tissue.triangles) == len(mesh.triangles)


def test_spire_that_would_reach_the_scope_is_refused():
    points = np.array([[-0.1, -0.1, 0.0], [0.1, -0.1, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.078]])
    spire = solid_from_tetrahedra(points, np.array([[0, 1, 2, 3]]))
    with pytest.raises(InvalidValueError, match="clearance between the scope's tip and the highest point"):
        Theatre(TheatreConfig(seed=0, working_distance_m=0.075), solid=spire)


def test_body_that_would_press_the_stage_into_the_table_is_refused():
    points = np.array([[-0.1, -0.1, 0.0], [0.1, -0.1, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.078]])
    spire = solid_from_tetrahedra(
        np.array([*points, *(points * [1, 1, 0] + [0, 0, 0.078])]), np.array([[0, 1, 2, 3], [4, 5, 6, 3]])
    )
    with pytest.raises(InvalidValueError, match="height of the stage"):
        Theatre(TheatreConfig(seed=0, working_distance_m=0.150), solid=spire)
