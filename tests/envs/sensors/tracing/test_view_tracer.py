import mujoco
import numpy as np
import pytest
import warp as wp

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.envs.sensors.kernels import ray_kernels, shading_kernels, shadow_kernels, spread_kernels, zbuffer_kernels
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.envs.sensors.tracing.scene_geometry import SceneGeometry
from laploop.errors import InvalidValueError, UnknownNameError
from laploop.perception.geometry import Rig

AT_ORIGIN = np.eye(4)
DEPTH_MM = 0.01  # what is promised; float32 at 0.1 m leaves about 0.00002 mm


def ray_grid(rig):
    return rig.camera.rays


@pytest.mark.parametrize("z", [0.03, 0.07, 0.1, 0.25])
def test_facing_plane_is_exact_at_every_pixel(camera, rig, make_plane, z):
    camera.attach_geometry(make_plane(z))
    view = camera.exact(None, AT_ORIGIN)
    np.testing.assert_allclose(view.depth_mm, z * 1e3, atol=DEPTH_MM)
    np.testing.assert_allclose(view.normals, np.broadcast_to([0.0, 0.0, -1.0], view.normals.shape), atol=1e-6)
    rays = ray_grid(rig)
    # 1e-6 in tangent units is 0.0002 px.
    np.testing.assert_allclose(view.projector_x, rays[..., 0] - rig.baseline_m / z, atol=1e-6)
    np.testing.assert_allclose(view.projector_y, rays[..., 1], atol=1e-6)
    assert (view.object_id == ObjectId.OTHER).all()


@pytest.mark.parametrize(("tilt_x", "tilt_y"), [(0.6, 0.0), (0.0, -0.7), (-0.5, 0.4)])
def test_tilted_plane_is_exact_at_every_pixel(camera, rig, make_plane, tilt_x, tilt_y):
    camera.attach_geometry(make_plane(0.1, tilt_x=tilt_x, tilt_y=tilt_y, half=0.2))
    view = camera.exact(None, AT_ORIGIN)
    rays = ray_grid(rig)
    slopes = np.array([np.tan(tilt_x), np.tan(tilt_y)])
    expected = 0.1 / (1.0 - rays[..., :2] @ slopes)
    inside = (np.abs(rays[..., :2] * expected[..., None]) < 0.199).all(axis=-1) & (expected > 0.0)
    assert inside.mean() > 0.5
    np.testing.assert_allclose(view.depth_mm[inside], expected[inside] * 1e3, atol=DEPTH_MM)
    normal = np.array([*slopes, -1.0]) / np.sqrt(1.0 + slopes @ slopes)
    np.testing.assert_allclose(view.normals[inside], np.broadcast_to(normal, (inside.sum(), 3)), atol=1e-5)


def test_floor_that_runs_on_behind_the_camera_is_exact(camera, rig):
    points = np.array([[-3.0, 0.02, -2.0], [3.0, 0.02, -2.0], [3.0, 0.02, 2.0], [-3.0, 0.02, 2.0]])
    camera.attach_geometry(SceneGeometry(points=points, triangles=np.array([[0, 1, 2], [0, 2, 3]]), object_ids=ObjectId.OTHER))
    view = camera.exact(None, AT_ORIGIN)
    rays = ray_grid(rig)
    below = rays[..., 1] > 0.02
    np.testing.assert_allclose(view.depth_mm[below], (20.0 / rays[..., 1])[below], rtol=1e-5)
    assert np.isnan(view.depth_mm[rays[..., 1] < 0.0]).all()


def test_sphere_of_a_model_is_exact(camera, rig):
    xml = """
    <mujoco><worldbody><geom name="ball" type="sphere" size="0.015" pos="0.004 -0.003 -0.09" group="1"/></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    camera.attach(model)
    view = camera.exact(data, np.diag([1.0, -1.0, -1.0, 1.0]))
    rays = ray_grid(rig)
    centre, radius = np.array([0.004, 0.003, 0.09]), 0.015
    a, b, c = (rays**2).sum(-1), rays @ centre, centre @ centre - radius**2
    discriminant = b**2 - a * c
    depth = (b - np.sqrt(np.maximum(discriminant, 0.0))) / a
    normal = (rays * depth[..., None] - centre) / radius
    facing = -(normal * rays).sum(-1) / np.sqrt(a)
    # Chords up to 4 um off the sphere; along a ray that meets it at 60 degrees, that counts double.
    clear = (discriminant > 0.0) & (facing > 0.5)
    assert clear.sum() > 2000
    np.testing.assert_allclose(view.depth_mm[clear], depth[clear] * 1e3, atol=DEPTH_MM)
    assert (np.sum(view.normals[clear] * normal[clear], axis=-1) > np.cos(np.radians(0.2))).all()
    assert np.isnan(view.depth_mm[discriminant < -1e-6]).all()


def test_nothing_hit_is_nan_and_background(camera, make_plane):
    camera.attach_geometry(make_plane(0.1, half=0.01))
    view = camera.exact(None, AT_ORIGIN)
    empty = view.object_id == ObjectId.BACKGROUND
    assert 0.5 < empty.mean() < 1.0
    for values in (view.depth_mm, view.projector_x, view.projector_y, view.normals[..., 0]):
        assert np.isnan(values[empty]).all()
        assert np.isfinite(values[~empty]).all()
    assert not view.lit[empty].any()


def test_lit_ends_at_the_border_of_the_mask(camera, rig, make_plane):
    camera.attach_geometry(make_plane(0.05))
    view = camera.exact(None, AT_ORIGIN)
    half = rig.mask.half_width_tan
    rays = ray_grid(rig)
    x_p, y_p = rays[..., 0] - rig.baseline_m / 0.05, rays[..., 1]
    np.testing.assert_array_equal(view.lit, (np.abs(x_p) <= half) & (np.abs(y_p) <= half))
    assert not view.lit[:, :20].any()
    assert view.lit[:, 25:].all()


def test_square_plate_casts_its_shadow_where_geometry_says(camera, rig, plate_before_wall):
    plate_z, half = 0.07, 0.008
    camera.attach_geometry(plate_before_wall(plate_z, plate_id=ObjectId.TOOL, half=half))
    view = camera.exact(None, AT_ORIGIN)
    rays = ray_grid(rig)
    on_plate = (np.abs(rays[..., :2]) * plate_z <= half).all(axis=-1)
    np.testing.assert_array_equal(view.object_id == ObjectId.TOOL, on_plate)
    point = rays * 0.1
    at_plate = (point[..., 0] - rig.baseline_m) * plate_z / 0.1 + rig.baseline_m, point[..., 1] * plate_z / 0.1
    shadow = (np.abs(at_plate[0]) <= half) & (np.abs(at_plate[1]) <= half)
    inside_mask = np.abs(rays[..., 0] - rig.baseline_m / 0.1) <= rig.mask.half_width_tan
    assert (shadow & ~on_plate).sum() > 100
    np.testing.assert_array_equal(view.lit[~on_plate], (~shadow & inside_mask)[~on_plate])
    assert view.lit[on_plate].all()


def test_disk_casts_its_shadow_where_geometry_says(camera, rig):
    xml = """
    <mujoco><worldbody>
      <geom name="stage/plate" type="plane" size="0.2 0.2 0.01" group="1"/>
      <geom name="tool_arm/disk" type="cylinder" size="0.006 0.0002" pos="0 0 0.0302" group="1"/>
    </worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    camera.attach(model)
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 0.1
    view = camera.exact(data, pose)
    point = ray_grid(rig)[..., :2] * 0.1
    stage = view.object_id == ObjectId.STAGE
    # The lower face, 70 mm from the projector, casts the larger shadow of the two.
    centre = np.array([rig.baseline_m, 0.0])
    distance = np.linalg.norm((point - centre) * 0.7 + centre, axis=-1)
    # 0.05 mm is a tenth of a pixel and covers the chords and the thickness of the disk.
    assert not view.lit[stage & (distance < 0.00595)].any()
    assert (stage & (distance < 0.00595)).sum() > 50
    assert view.lit[stage & (distance > 0.00605) & (np.abs(view.projector_x) < rig.mask.half_width_tan)].all()


@wp.kernel
def cast_rays(
    mesh: wp.uint64,
    rays: wp.array(dtype=wp.vec2),
    projector: wp.vec3,
    depth: wp.array(dtype=wp.float32),
    seen: wp.array(dtype=wp.uint8),
):
    i = wp.tid()
    direction = wp.vec3(rays[i][0], rays[i][1], 1.0)
    hit = wp.mesh_query_ray(mesh, wp.vec3(0.0, 0.0, 0.0), direction, 10.0)
    depth[i] = wp.where(hit.result, hit.t, wp.nan)
    if hit.result:
        way = hit.t * direction - projector
        facet = wp.where(wp.dot(hit.normal, direction) > 0.0, -hit.normal, hit.normal)
        if wp.dot(facet, way) < 0.0 and not wp.mesh_query_ray_anyhit(mesh, projector, way, 0.9998):
            seen[i] = wp.uint8(1)


def test_depth_maps_agree_with_rays_through_the_tree(camera, rig):
    rng = np.random.default_rng(3)
    side = np.linspace(-0.06, 0.06, 61)
    x, y = np.meshgrid(side, side, indexing="ij")
    z = 0.085 + 0.012 * np.abs(np.sin(180.0 * (x + 0.3 * y))) + 0.0005 * rng.standard_normal(x.shape)
    index = np.arange(61 * 61).reshape(61, 61)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    triangles = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    spikes = np.array([[0.0, 0.0, 0.07], [0.002, 0.0, 0.07], [0.06, 0.03, -0.05], [-0.01, 0.02, 0.06], [-0.01, 0.023, 0.06]])
    points = np.concatenate([np.stack([x, y, z], -1).reshape(-1, 3), spikes])
    triangles = np.concatenate([triangles, [[3721, 3722, 3723], [3724, 3725, 3721]]])
    scene = SceneGeometry(points=points, triangles=triangles, object_ids=ObjectId.TISSUE)
    camera.attach_geometry(scene)
    view = camera.exact(None, AT_ORIGIN)
    count = view.depth_mm.size
    mesh = wp.Mesh(points=wp.array(scene.points, dtype=wp.vec3), indices=wp.array(scene.triangles.ravel(), dtype=wp.int32))
    rays = wp.array(rig.camera.rays[..., :2].reshape(-1, 2).astype(np.float32), dtype=wp.vec2)
    depth, seen = wp.zeros(count, dtype=wp.float32), wp.zeros(count, dtype=wp.uint8)
    wp.launch(cast_rays, dim=count, inputs=[mesh.id, rays, wp.vec3(rig.baseline_m, 0.0, 0.0)], outputs=[depth, seen])
    np.testing.assert_allclose(view.depth_mm, depth.numpy().reshape(view.depth_mm.shape) * 1e3, atol=DEPTH_MM)
    inside = (np.abs(view.projector_x) <= rig.mask.half_width_tan) & (np.abs(view.projector_y) <= rig.mask.half_width_tan)
    seen_in_field = (seen.numpy().reshape(view.lit.shape) > 0) & inside
    assert (~seen_in_field & inside).sum() > 500
    # The depth map may take a shadow of an edge less than 0.3 mm in front, a tenth of a pixel wide, for the surface itself.
    assert (view.lit != seen_in_field).sum() <= 10


def test_flex_is_seen_where_it_deforms_to(camera, tmp_path, monkeypatch):
    # MuJoCo remarks, in a log in the current folder, that nothing but its elasticity holds the sheet.
    monkeypatch.chdir(tmp_path)
    xml = """
    <mujoco><option gravity="0 0 0"/><worldbody>
      <flexcomp name="sheet" type="grid" count="9 9 3" spacing="0.01 0.01 0.005" dim="3" radius="0.001" mass="0.1" pos="0 0 0">
        <elasticity young="1e4" poisson="0.3"/>
      </flexcomp>
    </worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    model.flex_group[:] = 1
    data = mujoco.MjData(model)
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 0.1
    geometry = camera.attach(model, rng=np.random.default_rng(0))
    factor = geometry.albedo_factor.copy()
    mujoco.mj_forward(model, data)
    before = camera.exact(data, pose)
    middle = (slice(120, 136), slice(120, 136))
    np.testing.assert_allclose(before.depth_mm[middle], 95.0, atol=DEPTH_MM)
    assert (before.object_id[middle] == ObjectId.TISSUE).all()
    data.qpos.reshape(-1, 3)[:, 2] += 0.004 + 0.2 * data.flexvert_xpos[:, 0]
    mujoco.mj_forward(model, data)
    after = camera.exact(data, pose)
    x = camera.rig.camera.rays[..., 0]
    # Plane z = 0.009 + 0.2 x seen from 0.1: depth = 0.091 / (1 + 0.2 x_c).
    np.testing.assert_allclose(after.depth_mm[middle], (91.0 / (1.0 + 0.2 * x))[middle], atol=DEPTH_MM)
    normal = np.array([-0.2, 0.0, -1.0]) / np.sqrt(1.04)
    np.testing.assert_allclose(after.normals[middle], np.broadcast_to(normal, (16, 16, 3)), atol=1e-4)
    np.testing.assert_array_equal(geometry.albedo_factor, factor)


def test_moving_rigid_geoms_are_followed(camera):
    xml = """
    <mujoco><worldbody><body name="b" pos="0 0 -0.1"><joint type="slide" axis="0 0 1"/>
      <geom name="tool_arm/tip" type="box" size="0.02 0.02 0.002" mass="1" group="1"/>
    </body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    camera.attach(model)
    for shift in (0.0, 0.02, -0.05):
        data.qpos[0] = shift
        mujoco.mj_forward(model, data)
        view = camera.exact(data, np.diag([1.0, -1.0, -1.0, 1.0]))
        np.testing.assert_allclose(view.depth_mm[128, 128], 98.0 - shift * 1e3, atol=DEPTH_MM)
        assert view.object_id[128, 128] == ObjectId.TOOL


def test_projector_far_wider_than_the_camera_lights_all_that_it_sees(make_plane):
    mask = StripeMask(fov_rad=3.0)
    camera = StripeCamera(Rig.from_optics(ScopeOptics(width=32, height=32, fov_rad=0.05, mask=mask)))
    camera.attach_geometry(make_plane(0.1))
    assert camera.exact(None, AT_ORIGIN).lit.all()


def test_threads_do_not_change_a_bit(rig, plate_before_wall):
    captures = []
    for threads in (1, 2, 3):
        camera = StripeCamera(rig, threads=threads)
        camera.attach_geometry(plate_before_wall(0.07, plate_id=ObjectId.TOOL))
        captures.append(camera.capture(None, AT_ORIGIN, np.random.default_rng(5)))
    for other in captures[1:]:
        for name, values in vars(captures[0]).items():
            np.testing.assert_array_equal(values, getattr(other, name))


def test_depth_alone_is_that_of_the_whole_view(camera, plate_before_wall):
    pose = np.eye(4)
    pose[:3, 3] = 0.01, -0.02, 0.005
    wall = plate_before_wall(0.07, plate_id=ObjectId.TOOL)
    wall.move(np.minimum(wall.points, [0.03, 1.0, 1.0]))
    camera.attach_geometry(wall)
    snapshot = camera.snapshot(None, pose)
    depth, exact = camera.depth_view(snapshot), camera.exact_view(snapshot)
    # Something of everything: wall, plate and nothing.
    assert set(np.unique(exact.object_id)) == {ObjectId.BACKGROUND, ObjectId.TOOL, ObjectId.OTHER}
    np.testing.assert_array_equal(depth.depth_mm, exact.depth_mm)
    np.testing.assert_array_equal(depth.object_id, exact.object_id)


def test_a_snapshot_shows_the_scene_as_it_was(camera, make_plane):
    scene = make_plane(0.09)
    camera.attach_geometry(scene)
    snapshot = camera.snapshot(None, AT_ORIGIN)
    scene.move(scene.points + np.array([0.0, 0.0, 0.02]))
    np.testing.assert_allclose(camera.exact_view(snapshot).depth_mm, 90.0, atol=DEPTH_MM)
    np.testing.assert_allclose(camera.exact(None, AT_ORIGIN).depth_mm, 110.0, atol=DEPTH_MM)


def test_results_do_not_change_when_the_next_image_is_taken(camera, make_plane):
    camera.attach_geometry(make_plane(0.09))
    first = camera.capture(None, AT_ORIGIN, None)
    kept = {name: values.copy() for name, values in vars(first).items()}
    camera.attach_geometry(make_plane(0.06, tilt_x=0.2))
    camera.capture(None, AT_ORIGIN, np.random.default_rng(0))
    for name, values in kept.items():
        np.testing.assert_array_equal(getattr(first, name), values)


def test_kernels_compile_for_cuda(tmp_path):
    for module in (ray_kernels, shading_kernels, shadow_kernels, spread_kernels, zbuffer_kernels):
        wp.compile_aot_module(module, arch=80, module_dir=tmp_path, use_ptx=True)
    assert len(list(tmp_path.glob("*.ptx"))) == 5


def test_bad_input_is_refused(rig, make_plane):
    with pytest.raises(UnknownNameError, match="device 'abacus'"):
        StripeCamera(rig, device="abacus")
    with pytest.raises(InvalidValueError, match="threads is 0"):
        StripeCamera(rig, threads=0)
    camera = StripeCamera(rig, threads=1)
    with pytest.raises(InvalidValueError, match="scene"):
        camera.exact(None, AT_ORIGIN)
    camera.attach_geometry(make_plane(0.1))
    broken = AT_ORIGIN.copy()
    broken[0, 3] = np.nan
    for pose in (np.eye(3), 2.0 * np.eye(4), broken):
        with pytest.raises(InvalidValueError, match="world_from_camera"):
            camera.exact(None, pose)
