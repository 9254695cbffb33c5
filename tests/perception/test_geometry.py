"""Camera and rig against numbers computed by hand; each convention has a test that its opposite fails."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from laploop.assets.stripe_mask import StripeMask
from laploop.errors import InvalidValueError
from laploop.perception.geometry import Intrinsics, Rig, invert_transform, transform_points

CAMERA = Intrinsics(width=6, height=4, fx=5.0, fy=7.0, cx=2.75, cy=1.875)
"""Neither centred nor square, so that a swapped axis shows."""

RIG = Rig(camera=CAMERA, baseline_m=0.005, mask=StripeMask())


def pixel_centres(camera):
    column, row = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    return np.stack([column, row], axis=-1)


def some_pose():
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("xyz", [20.0, -35.0, 110.0], degrees=True).as_matrix()
    pose[:3, 3] = [0.3, -0.2, 0.5]
    return pose


def test_the_field_of_view_ends_at_the_borders_of_the_image():
    camera = Intrinsics.from_fov(width=4, height=2, fov_rad=np.pi / 2.0)
    # At 45 degrees to either side x = +-z, which are the outer edges of the first and the last column: u = 0 and u = 4.
    edges = np.array([[-0.1, 0.0, 0.1], [0.1, 0.0, 0.1]])
    np.testing.assert_allclose(camera.project(edges), [[0.0, 1.0], [4.0, 1.0]], atol=1e-12)
    assert camera.fx == camera.fy == pytest.approx(2.0)


def test_rays_pass_through_pixel_centres():
    camera = Intrinsics.from_fov(width=4, height=2, fov_rad=np.pi / 2.0)
    # The centre of the first pixel is (0.5, 0.5): (0.5 - 2) / 2 and (0.5 - 1) / 2.
    np.testing.assert_allclose(camera.rays[0, 0], [-0.75, -0.25, 1.0], atol=1e-15)
    np.testing.assert_allclose(camera.rays[1, 3], [0.75, 0.25, 1.0], atol=1e-15)
    np.testing.assert_allclose(CAMERA.project(CAMERA.rays), pixel_centres(CAMERA), atol=1e-12)


def test_x_points_right_and_y_down():
    middle, right, down = CAMERA.project(np.array([[0.0, 0.0, 0.1], [0.01, 0.0, 0.1], [0.0, 0.01, 0.1]]))
    np.testing.assert_allclose(middle, [2.75, 1.875])
    # 0.01 / 0.1 of the focal lengths of 5 and 7 pixels.
    np.testing.assert_allclose(right - middle, [0.5, 0.0], atol=1e-12)
    np.testing.assert_allclose(down - middle, [0.0, 0.7], atol=1e-12)


def test_projecting_what_was_unprojected_gives_the_pixel_centres_back():
    pixels = pixel_centres(CAMERA)
    depth = np.random.default_rng(0).uniform(0.05, 0.15, pixels.shape[:2])
    points = CAMERA.unproject(pixels, depth)
    # Depth is z, not the length of the ray.
    np.testing.assert_array_equal(points[..., 2], depth)
    np.testing.assert_allclose(CAMERA.project(points), pixels, atol=1e-12)
    np.testing.assert_allclose(points, CAMERA.rays * depth[..., None], atol=1e-15)
    np.testing.assert_allclose(CAMERA.unproject(pixels[0, 0], 0.2), 0.2 * CAMERA.rays[0, 0], atol=1e-15)


def test_the_matrix_projects_as_the_camera_does():
    points = np.random.default_rng(1).uniform([-0.05, -0.05, 0.05], [0.05, 0.05, 0.15], (20, 3))
    homogeneous = points @ CAMERA.matrix.T
    np.testing.assert_allclose(homogeneous[:, :2] / homogeneous[:, 2:], CAMERA.project(points), atol=1e-12)


@pytest.mark.parametrize("name", ["width", "height", "fx", "fy"])
def test_a_camera_without_size_or_focal_length_is_refused(name):
    good = {"width": 6, "height": 4, "fx": 5.0, "fy": 5.0, "cx": 3.0, "cy": 2.0}
    with pytest.raises(InvalidValueError, match=name):
        Intrinsics(**{**good, name: 0})


def test_the_projector_stands_on_the_cameras_right():
    # Seen from 5 mm to the right, a point straight ahead of the camera lies 5 mm to the left, and one 5 mm to its right ahead.
    points = np.array([[0.0, 0.002, 0.1], [0.005, -0.001, 0.1]])
    np.testing.assert_allclose(
        transform_points(RIG.projector_from_camera, points), [[-0.005, 0.002, 0.1], [0.0, -0.001, 0.1]], atol=1e-15
    )


def test_projector_coordinates_are_as_computed_by_hand():
    depth = np.full((4, 6), 0.1)
    seen = RIG.projector_x(depth)
    # In the first column x_c = (0.5 - 2.75) / 5 = -0.45; the baseline over the depth is 0.005 / 0.1 = 0.05.
    np.testing.assert_allclose(seen[:, 0], -0.50, atol=1e-15)
    # In the third, x_c = (2.5 - 2.75) / 5 = -0.05.
    np.testing.assert_allclose(seen[:, 2], -0.10, atol=1e-15)
    # The nearer a point, the farther to the left the projector sees it.
    assert (RIG.projector_x(0.5 * depth) < seen).all()


def test_projector_coordinates_are_those_of_the_points_in_its_frame():
    depth = np.random.default_rng(2).uniform(0.05, 0.15, (4, 6))
    points = transform_points(RIG.projector_from_camera, CAMERA.unproject(pixel_centres(CAMERA), depth))
    np.testing.assert_allclose(RIG.projector_x(depth), points[..., 0] / points[..., 2], atol=1e-14)


def test_triangulation_gives_the_depth_back_and_no_depth_where_rays_diverge():
    depth = np.random.default_rng(3).uniform(0.05, 0.15, (4, 6))
    np.testing.assert_allclose(RIG.depth_from_projector_x(RIG.projector_x(depth)), depth, rtol=1e-12)
    assert np.isnan(RIG.depth_from_projector_x(CAMERA.rays[..., 0])).all()
    assert np.isnan(RIG.depth_from_projector_x(CAMERA.rays[..., 0] + 0.01)).all()


def test_the_inverse_of_a_rigid_transform_undoes_it():
    world_from_camera = some_pose()
    camera_from_world = invert_transform(world_from_camera)
    np.testing.assert_allclose(camera_from_world, np.linalg.inv(world_from_camera), atol=1e-14)
    np.testing.assert_allclose(camera_from_world @ world_from_camera, np.eye(4), atol=1e-14)
    points = np.random.default_rng(4).normal(size=(2, 5, 3))
    there_and_back = transform_points(camera_from_world, transform_points(world_from_camera, points))
    np.testing.assert_allclose(there_and_back, points, atol=1e-14)


def test_points_are_rotated_first_and_shifted_then():
    a_from_b = np.eye(4)
    # A quarter turn about z takes x to y.
    a_from_b[:3, :3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    a_from_b[:3, 3] = [10.0, 20.0, 30.0]
    np.testing.assert_array_equal(transform_points(a_from_b, np.array([1.0, 2.0, 3.0])), [8.0, 21.0, 33.0])
