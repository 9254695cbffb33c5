"""The simulated bench: even light, poses of the board, and what is left when nothing is wrong with the calibration."""

from dataclasses import replace

import numpy as np
import pytest

from laploop.assets.calibration_board import CalibrationBoard, blank_card
from laploop.assets.tissue_config import TissueConfig
from laploop.envs.sensors.reference.optics import ReferenceOptics
from laploop.errors import InfeasibleError, InvalidValueError
from laploop.perception.geometry import invert_transform, transform_points
from laploop.perception.reprojection import reproject
from laploop.studies.calibration.views import BoardStand, between, depth_slices, draw_pose, is_lit, take_view
from laploop.studies.scenes.optical_bench import OpticalBench
from laploop.studies.scenes.training_scene import TrainingScene

BENCH = OpticalBench()
BOARD = CalibrationBoard()


def test_light_without_stripes_is_even():
    contrasts = []
    for clear in (False, True):
        camera = BENCH.scope_camera(clear_mask=clear, threads=1)
        BoardStand(blank_card(200.0, 200.0), [camera]).place(facing(0.09))
        # A period of the stripes has 13 columns; farther from the axis the lens's fall-off shows.
        values = camera.capture(None, np.eye(4), None).electrons[110:146, 125:161]
        contrasts.append(float(np.ptp(values) / (values.max() + values.min())))
    assert contrasts[0] > 0.4
    assert contrasts[1] < 0.1  # fall-off towards the border of the field


def facing(depth_m):
    pose = np.eye(4)
    pose[2, 3] = depth_m
    return pose


def test_drawn_boards_are_in_view_and_lit():
    rng = np.random.default_rng(0)
    rig = BENCH.rig
    depths = depth_slices((0.075, 0.13), 6)
    assert depths[0][0] == 0.075
    assert depths[-1][1] == 0.13
    for slice_m in depths:
        pose = draw_pose(rng, BOARD, rig.camera, depths_m=slice_m, tilt_deg=30.0, seen=lambda p: is_lit(p, BOARD, rig))
        pixels = rig.camera.project(transform_points(pose, BOARD.corners))
        assert pixels.min() > 0.0
        assert pixels.max() < 256.0
        assert slice_m[0] <= transform_points(pose, BOARD.centre)[2] <= slice_m[1]
        tangent = transform_points(rig.projector_from_camera @ pose, BOARD.corners)
        assert np.abs(tangent[:, 0] / tangent[:, 2]).max() < rig.mask.half_width_tan


def test_a_board_that_is_too_large_is_refused():
    with pytest.raises(InfeasibleError, match="8 x 7 squares of 30 mm at 70 to 80 mm"):
        draw_pose(
            np.random.default_rng(0), replace(BOARD, square_mm=30.0), BENCH.rig.camera, depths_m=(0.07, 0.08), tilt_deg=5.0
        )


def test_a_view_without_the_board_is_taken_again_until_there_is_no_sense_in_it():
    taken = []

    def picture(pose):
        taken.append(pose)
        return [np.zeros((256, 256), np.uint8)]

    with pytest.raises(InfeasibleError, match="not found in the pictures of 20 poses"):
        take_view(lambda: facing(0.1), picture, BOARD)
    assert len(taken) == 20


def test_a_board_between_two_cameras_faces_both_alike():
    transform = BENCH.scope_from_reference
    base = between(transform)
    np.testing.assert_allclose(base @ base.T, np.eye(3), atol=1e-12)
    assert base[2, 2] == pytest.approx(base[:, 2] @ transform[:3, 2])


def test_bench_has_its_cameras_where_it_says():
    origin_in_scope = invert_transform(BENCH.world_from_scope)[:3, 3]
    np.testing.assert_allclose(origin_in_scope, [0.0, 0.0, 0.095], atol=1e-12)
    origin_in_reference = invert_transform(BENCH.world_from_reference)[:3, 3]
    np.testing.assert_allclose(origin_in_reference, [0.0, 0.0, 0.6], atol=1e-12)
    np.testing.assert_allclose(transform_points(BENCH.scope_from_reference, origin_in_reference), origin_in_scope, atol=1e-12)


@pytest.mark.parametrize("change", [{"nominal_distance_m": 0.01}, {"reference_distance_m": 2.0}])
def test_impossible_benches_are_refused(change):
    with pytest.raises(InvalidValueError, match=next(iter(change))):
        OpticalBench(**change)


def test_with_the_true_transform_reference_and_exact_depth_agree_to_the_noise():
    optics = ReferenceOptics(sampling="full", dimension_trueness=0.0, planarity_trueness_mm=0.0)
    bench = OpticalBench(reference=optics)
    scene = TrainingScene(TissueConfig(), np.random.default_rng(3))
    lifted = np.eye(4)
    lifted[2, 3] = scene.mean_height_m
    scope, reference = bench.scope_camera(threads=1), bench.reference_camera(threads=1)
    for camera in (scope, reference):
        camera.attach(scene.model)
    exact = scope.exact(scene.data, lifted @ bench.world_from_scope).depth_mm
    cloud = reference.capture(scene.data, lifted @ bench.world_from_reference, np.random.default_rng(0)).xyz
    found = reproject(cloud, bench.scope_from_reference, bench.rig.camera)
    step = np.full_like(exact, np.nan)
    step[1:-1, 1:-1] = np.max(
        [np.abs(exact[1:-1, 1:-1] - other) for other in (exact[:-2, 1:-1], exact[2:, 1:-1], exact[1:-1, :-2], exact[1:-1, 2:])],
        axis=0,
    )
    smooth = found.mask & (step < 1.0)
    difference = (found.depth_mm - exact)[smooth]
    assert found.mask.mean() > 0.9
    # At depth edges, a pixel sees both sides; they are few (1.4 % here).
    assert smooth.sum() > 0.95 * (found.mask & np.isfinite(step)).sum()
    # Noise of 0.08 mm; a pixel keeps the nearest of some three points, and a point may lie half a pixel from its centre. Half a
    # pixel or a tenth of a degree wrong would make 0.3 mm and more.
    assert np.median(np.abs(difference)) < 1.6 * optics.point_noise_mm
    assert abs(np.median(difference)) < 1.5 * optics.point_noise_mm
