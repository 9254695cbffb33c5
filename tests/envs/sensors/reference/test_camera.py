from dataclasses import replace

import numpy as np
import pytest

from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.optics.stripe_optics import Material
from laploop.envs.sensors.reference.camera import ReferenceCamera, lateral_mount
from laploop.envs.sensors.reference.optics import ReferenceOptics
from laploop.envs.sensors.tracing import primitives
from laploop.envs.sensors.tracing.scene_geometry import SceneGeometry
from laploop.envs.theatre.config import TheatreConfig
from laploop.envs.theatre.theatre import Theatre
from laploop.errors import InvalidValueError, UnknownNameError
from laploop.perception.geometry import transform_points

AT_ORIGIN = np.eye(4)
COARSE = ReferenceOptics(sampling="4x4")
IDEAL = COARSE.ideal()
EXACT_MM = 2e-3  # float32 rounding of 1100 mm, some times over
REGION = (201, 150, 220, 160)
COLUMN, ROW, WIDTH, HEIGHT = REGION
CROP = (slice(ROW, ROW + HEIGHT), slice(COLUMN, COLUMN + WIDTH))


@pytest.fixture(scope="module")
def ideal_camera():
    return ReferenceCamera(IDEAL)


def projector_centre():
    transform = IDEAL.rig.projector_from_camera
    return -transform[:3, :3].T @ transform[:3, 3]


def in_projector_field(points_in_camera):
    point = transform_points(IDEAL.rig.projector_from_camera, points_in_camera)
    x, y = np.abs(point[..., 0] / point[..., 2]), np.abs(point[..., 1] / point[..., 2])
    return (x <= IDEAL.projector_half_width_tan) & (y <= IDEAL.projector_half_height_tan) & (point[..., 2] > 0.0)


def crosses_box(start, end, low, high):
    """Tell for each segment from `start` to `end` whether it meets the box, and where (0 to 1), by slabs."""
    way = end - start
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low - start) / way, (high - start) / way
    enter, leave = np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)
    return (enter <= leave) & (leave > 0.0) & (enter < 1.0), enter


@pytest.mark.parametrize("z", [0.31, 0.6, 1.09])
def test_facing_plane_is_exact_where_the_projector_reaches_and_nan_elsewhere(ideal_camera, make_plane, z):
    ideal_camera.attach_geometry(make_plane(z))
    capture = ideal_camera.capture(None, AT_ORIGIN, None)
    points = IDEAL.intrinsics.rays * z
    lit = in_projector_field(points)
    assert 0.5 < lit.mean() < 0.95
    np.testing.assert_array_equal(capture.valid, lit)
    np.testing.assert_allclose(capture.z[lit], 1e3 * z, atol=EXACT_MM)
    np.testing.assert_allclose(capture.xyz[lit], 1e3 * points[lit], atol=EXACT_MM)
    np.testing.assert_allclose(capture.normals[lit], np.broadcast_to([0.0, 0.0, -1.0], (lit.sum(), 3)), atol=1e-6)


@pytest.mark.parametrize("z", [0.29, 1.11])
def test_nothing_is_measured_outside_the_working_range(ideal_camera, make_plane, z):
    ideal_camera.attach_geometry(make_plane(z))
    assert not ideal_camera.capture(None, AT_ORIGIN, None).valid.any()


def test_box_on_a_plane_casts_its_shadow_on_the_side_away_from_the_projector(ideal_camera, make_plane):
    low, high, wall_z = np.array([-0.04, -0.03, 0.52]), np.array([0.03, 0.05, 0.6]), 0.6
    wall = make_plane(wall_z)
    box_points, box_triangles = primitives.box(*(0.5 * (high - low)))
    scene = SceneGeometry(
        points=np.concatenate([wall.points, box_points + 0.5 * (low + high)]),
        triangles=np.concatenate([wall.triangles, box_triangles + 4]),
        object_ids=np.repeat([ObjectId.OTHER, ObjectId.TISSUE], [2, 12]),
        parts=np.repeat([0, 1], [2, 12]),
    )
    ideal_camera.attach_geometry(scene)
    capture = ideal_camera.capture(None, AT_ORIGIN, None)
    on_wall = IDEAL.intrinsics.rays * wall_z
    on_box, where = crosses_box(np.zeros(3), on_wall, low, high)
    points = np.where(on_box[..., None], on_wall * where[..., None], on_wall)
    shadow = ~on_box & crosses_box(projector_centre(), on_wall, low, high)[0]
    # Faces of the box that the camera sees, and the projector, to the right, does not: the left one.
    left_face = on_box & (np.abs(points[..., 0] - low[0]) < 1e-9)
    expected = in_projector_field(points) & ~shadow & ~left_face
    # Pixels whose centre is within rounding of an edge may fall on either side of it.
    assert (capture.valid != expected).sum() <= 0.002 * shadow.sum()
    both = capture.valid & expected
    np.testing.assert_allclose(capture.z[both], 1e3 * points[..., 2][both], atol=EXACT_MM)
    rows, columns = np.nonzero(shadow)
    assert len(rows) > 1000
    assert columns.max() < np.nonzero(on_box)[1].max()
    assert columns.min() < np.nonzero(on_box)[1].min() - 5
    right_of_box = np.arange(612) > np.nonzero(on_box)[1].max() + 1
    inside = in_projector_field(on_wall)
    np.testing.assert_array_equal(capture.valid[:, right_of_box], inside[:, right_of_box])
    # In the colour picture the shadow is dark, not missing.
    assert capture.rgba[..., 0][shadow].max() < capture.rgba[..., 0][both & ~on_box].min()


@pytest.mark.parametrize("z", [0.4, 0.6, 1.0])
def test_point_noise_is_that_of_the_data_sheet_and_proportional_to_distance(make_plane, z):
    camera = ReferenceCamera(COARSE)
    camera.attach_geometry(make_plane(z))
    middle = (slice(206, 306), slice(256, 356))
    capture = camera.capture(None, AT_ORIGIN, np.random.default_rng(1))
    systematic = 1e3 * z * (1.0 + camera.noise.scale) + camera.noise.bend_mm
    error = (capture.z - systematic)[middle]
    expected = 0.08 * z / 0.6
    # 10 000 points tell a standard deviation to 1 %; the projector's slanting light adds up to 2 %.
    assert error.std() == pytest.approx(expected, rel=0.05)
    assert abs(error.mean()) < 5.0 * expected / 100.0
    # Without a generator, the camera's own errors stay and the noise goes.
    np.testing.assert_allclose(camera.capture(None, AT_ORIGIN, None).z[middle], systematic[middle], atol=EXACT_MM)


def test_noise_grows_on_slanting_and_on_dark_surfaces(make_plane):
    camera = ReferenceCamera(COARSE)
    middle = (slice(206, 306), slice(256, 356))

    def spread(**plane):
        scene = make_plane(0.6, tilt_y=plane.get("tilt", 0.0))
        scene.albedo_factor[:] = plane.get("factor", 1.0)
        camera.attach_geometry(scene)
        noisy, clean = (camera.capture(None, AT_ORIGIN, rng) for rng in (np.random.default_rng(2), None))
        return ((noisy.z - clean.z) / clean.z)[middle].std()

    facing = spread()
    # A quarter of the light halves a ratio limited by shot noise.
    assert spread(factor=0.25) == pytest.approx(2.0 * facing, rel=0.03)
    # 60 degrees: half the cosine doubles it, half the light takes another root of two; the angle varies by 4 degrees.
    assert spread(tilt=np.pi / 3.0) == pytest.approx(2.0 * np.sqrt(2.0) * facing, rel=0.1)


def test_dark_points_are_missing(make_plane):
    camera = ReferenceCamera(replace(IDEAL, snr_min=7.0))
    scene = make_plane(0.6)
    for factor, found in ((0.03, False), (0.06, True)):  # 7/35 squared is 0.04
        scene.albedo_factor[:] = factor
        camera.attach_geometry(scene)
        middle = camera.capture(None, AT_ORIGIN, None).valid[206:306, 256:356]
        assert middle.all() if found else not middle.any()


def test_mirrored_projector_saturates_where_geometry_says(make_plane):
    varnish = Material(albedo=0.3, reflectance=0.04, roughness=0.05)
    camera = ReferenceCamera(replace(IDEAL, saturated_is_missing=True, other=varnish))
    camera.attach_geometry(make_plane(0.6))
    capture = camera.capture(None, AT_ORIGIN, None)
    centre = projector_centre()
    # The mirror image of the projector behind the plane, seen from the camera.
    mirrored = centre * [1.0, 1.0, -1.0] + [0.0, 0.0, 1.2]
    column, row = IDEAL.intrinsics.project(mirrored)
    rows, columns = np.nonzero(~capture.valid & in_projector_field(IDEAL.intrinsics.rays * 0.6))
    assert len(rows) > 20
    # Pixels of about 1 mm; the highlight is symmetric about the mirror's point but for the slant of the light.
    assert rows.mean() + 0.5 == pytest.approx(row, abs=0.5)
    assert columns.mean() + 0.5 == pytest.approx(column, abs=2.0)
    assert max(np.ptp(rows), np.ptp(columns)) < 100
    assert (capture.rgba[int(row), int(column)] == 255).all()
    camera = ReferenceCamera(replace(IDEAL, other=varnish))
    camera.attach_geometry(make_plane(0.6))
    assert camera.capture(None, AT_ORIGIN, None).valid[int(row), int(column)]


def test_without_need_of_a_projector_only_range_decides(make_plane):
    camera = ReferenceCamera(replace(COARSE, needs_projector=False, dimension_trueness=0.0, planarity_trueness_mm=0.0))
    camera.attach_geometry(make_plane(0.6))
    capture = camera.capture(None, AT_ORIGIN, np.random.default_rng(0))
    assert capture.valid.all()
    # Where no light falls, twenty times 0.08 mm; five deviations of it.
    assert np.abs(capture.z - 600.0).max() < 5.0 * 1.6
    dark = ~in_projector_field(IDEAL.intrinsics.rays * 0.6)
    assert (capture.snr[dark] == 0.0).all()


def test_arrays_belong_together(make_plane):
    camera = ReferenceCamera(COARSE)
    camera.attach_geometry(make_plane(0.6, tilt_x=0.3, half=0.15))
    capture = camera.capture(None, AT_ORIGIN, np.random.default_rng(0))
    shape = (512, 612)
    assert (capture.xyz.shape, capture.z.shape, capture.rgba.shape) == ((*shape, 3), shape, (*shape, 4))
    assert (capture.normals.shape, capture.snr.shape) == ((*shape, 3), shape)
    for values in (capture.xyz, capture.z, capture.normals, capture.snr):
        assert values.dtype == np.float32
        missing = np.isnan(values).reshape(*shape, -1)
        np.testing.assert_array_equal(missing, np.broadcast_to(~capture.valid[..., None], missing.shape))
    valid = capture.valid
    assert 0.05 < valid.mean() < 0.5
    np.testing.assert_array_equal(capture.xyz[..., 2][valid], capture.z[valid])
    rays = capture.xyz[valid] / capture.z[valid][:, None]
    np.testing.assert_allclose(rays, camera.intrinsics.rays[valid], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(capture.normals[valid], axis=-1), 1.0, atol=1e-5)
    assert capture.rgba.dtype == np.uint8
    assert (capture.rgba[..., 3] == 255).all()


def test_normals_are_as_noisy_as_planes_through_their_neighbours(make_plane):
    camera = ReferenceCamera(COARSE)
    camera.attach_geometry(make_plane(0.6))
    normals = camera.capture(None, AT_ORIGIN, np.random.default_rng(0)).normals[206:306, 256:356]
    pitch_mm, window = 600.0 / camera.intrinsics.fx, np.arange(5) - 2.0
    # Slope of a least-squares line, five times over: the 5 x 5 points of the default window.
    expected = 0.08 / (pitch_mm * np.sqrt(5.0 * (window**2).sum()))
    assert normals[..., 0].std() == pytest.approx(expected, rel=0.05)
    assert normals[..., 1].std() == pytest.approx(expected, rel=0.05)


def test_same_seed_gives_the_same_bits_with_any_number_of_threads(make_plane):
    captures = []
    for threads, seed in ((1, 5), (2, 5), (3, 5), (1, 6)):
        camera = ReferenceCamera(COARSE, threads=threads)
        camera.attach_geometry(make_plane(0.6, tilt_x=0.2, half=0.2))
        captures.append(camera.capture(None, AT_ORIGIN, np.random.default_rng(seed)))
    for other in captures[1:3]:
        for name, values in vars(captures[0]).items():
            np.testing.assert_array_equal(values, getattr(other, name))
    assert (captures[0].z != captures[3].z)[captures[0].valid].mean() > 0.9


def test_tissue_in_the_theatre_is_measured_from_the_side():
    theatre = Theatre(TheatreConfig(seed=3))
    theatre.refresh()
    surface = theatre.tissue.surface_points()[: theatre.tissue.top_vertex_count]
    pose = lateral_mount(surface.mean(axis=0))
    camera = ReferenceCamera(COARSE)
    camera.attach(theatre.model, tissue=theatre.tissue, rng=np.random.default_rng(0))
    capture = camera.capture(theatre.data, pose, np.random.default_rng(1))
    tissue = camera.exact(theatre.data, pose).object_id == ObjectId.TISSUE
    assert tissue.sum() > 8000
    assert capture.valid[tissue].mean() > 0.85
    world = transform_points(pose, capture.xyz[capture.valid & tissue] * 1e-3)
    # Of 600 mm, 0.2 % scale error, 0.1 mm bend and five deviations of noise make 1.8 mm.
    assert world[:, 2].max() < surface[:, 2].max() + 0.002
    assert np.abs(np.median(capture.z[tissue & capture.valid]) - 600.0) < 20.0


def test_lateral_mount_looks_at_its_target_with_a_level_image():
    target = np.array([0.01, -0.02, 0.1])
    for azimuth in (-1.6, 0.0, 2.0):
        pose = lateral_mount(target, distance_m=0.7, azimuth_rad=azimuth, elevation_rad=0.8)
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
        np.testing.assert_allclose(pose @ [0.0, 0.0, 0.7, 1.0], [*target, 1.0], atol=1e-12)
        assert pose[2, 0] == pytest.approx(0.0, abs=1e-12)
        assert pose[2, 1] < 0.0
    assert lateral_mount(target)[1, 3] < target[1] - 0.3


def test_bad_input_is_refused(ideal_camera):
    with pytest.raises(UnknownNameError, match="sampling '3x3'; available: 2x2, 4x4, full"):
        ReferenceOptics(sampling="3x3")
    for name, value in (("width", 50), ("unit_seed", -1), ("normal_window_px", 4), ("point_noise_mm", -0.1), ("far_m", 0.2)):
        with pytest.raises(InvalidValueError, match=f"{name} is"):
            ReferenceOptics(**{name: value})
    with pytest.raises(InvalidValueError, match="scene"):
        ReferenceCamera(COARSE).capture(None, AT_ORIGIN, None)
    for name, value in (("distance_m", 0.0), ("elevation_rad", 1.57)):
        with pytest.raises(InvalidValueError, match=name):
            lateral_mount([0.0, 0.0, 0.0], **{name: value})
    with pytest.raises(InvalidValueError, match="target_in_world"):
        lateral_mount([0.0, np.nan, 0.0])


def _scene():
    """Return a bumpy sheet 600 mm away with a card before it that throws a shadow."""
    x, y = np.meshgrid(np.linspace(-0.15, 0.15, 40), np.linspace(-0.12, 0.12, 40))
    sheet = np.stack([x, y, 0.6 + 0.01 * np.sin(40.0 * x) * np.cos(50.0 * y)], axis=-1).reshape(-1, 3)
    first = (np.arange(39)[:, None] * 40 + np.arange(39)).ravel()
    triangles = np.concatenate([np.stack([first, first + 1, first + 41], 1), np.stack([first, first + 41, first + 40], 1)])
    card = np.array([[-0.02, -0.03, 0.55], [0.01, -0.03, 0.55], [0.01, 0.02, 0.55], [-0.02, 0.02, 0.55]])
    return SceneGeometry(
        points=np.concatenate([sheet, card]),
        triangles=np.concatenate([triangles, len(sheet) + np.array([[0, 1, 2], [0, 2, 3]])]),
        object_ids=int(ObjectId.TISSUE),
    )


def _capture(optics, rng=None):
    camera = ReferenceCamera(optics, threads=1)
    camera.attach_geometry(_scene())
    return camera.capture(None, np.eye(4), rng)


def test_region_is_the_crop_of_the_whole_image():
    whole, region = _capture(COARSE), _capture(replace(COARSE, region=REGION))
    assert region.z.shape == (HEIGHT, WIDTH)
    np.testing.assert_array_equal(region.valid, whole.valid[CROP])
    # Both kinds of point are there.
    assert region.valid.any()
    assert not region.valid.all()
    np.testing.assert_allclose(region.z, whole.z[CROP], atol=1.3e-4)  # mm, two units of single precision at 600 mm
    np.testing.assert_allclose(region.xyz, whole.xyz[CROP], atol=1.3e-4)
    np.testing.assert_allclose(region.normals, whole.normals[CROP], atol=1e-5)
    np.testing.assert_allclose(region.snr, whole.snr[CROP], rtol=1e-5)
    # At the border the lens's blur knows nothing of what lies outside.
    inside = (slice(2, -2), slice(2, -2))
    np.testing.assert_allclose(region.rgba[inside].astype(int), whole.rgba[CROP][inside].astype(int), atol=1)


def test_points_follow_from_depth_and_the_intrinsics_of_the_region():
    optics = replace(COARSE, region=REGION)
    region = _capture(optics, np.random.default_rng(1))
    rays = optics.intrinsics.rays.astype(np.float32)
    np.testing.assert_array_equal(region.xyz, rays * region.z[..., None])


def test_region_of_the_whole_image_changes_no_bit():
    k = COARSE.intrinsics
    full = replace(COARSE, region=(0, 0, k.width, k.height))
    assert full.intrinsics == k
    assert full.window == COARSE.window
    one, other = (_capture(optics, np.random.default_rng(3)) for optics in (COARSE, full))
    for name in ("xyz", "z", "rgba", "normals", "snr"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
