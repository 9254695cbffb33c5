import numpy as np
import pytest

from laploop.envs.loop.kinematic_errors import KinematicErrors
from laploop.errors import InvalidValueError
from laploop.perception.calibration.results import CameraCalibration
from laploop.perception.geometry import Intrinsics
from laploop.perception.reprojection import BrownDistortion


def test_no_error_is_the_default():
    drawn = KinematicErrors().draw(np.random.default_rng(0))
    assert not drawn.joint_offsets_rad.any()
    assert not drawn.tip_offset_m.any()
    assert np.array_equal(drawn.camera_from_nominal, np.eye(4))


def test_same_seed_draws_the_same_robot_and_errors_do_not_disturb_each_other():
    both = KinematicErrors(joint_rad=0.001, tip_m=0.0005, hand_eye_m=0.001, hand_eye_rad=0.003)
    one = both.draw(np.random.default_rng(3))
    again = both.draw(np.random.default_rng(3))
    alone = KinematicErrors(hand_eye_m=0.001).draw(np.random.default_rng(3))
    assert np.array_equal(one.camera_from_nominal, again.camera_from_nominal)
    assert np.array_equal(one.joint_offsets_rad, again.joint_offsets_rad)
    assert np.array_equal(one.camera_from_nominal[:3, 3], alone.camera_from_nominal[:3, 3])


def test_draws_have_the_stated_spread():
    rng = np.random.default_rng(1)
    errors = KinematicErrors(joint_rad=0.001, tip_m=0.0005, hand_eye_m=0.002, hand_eye_rad=0.01)
    drawn = [errors.draw(rng) for _ in range(1500)]
    # 4 %: three standard errors of a standard deviation over 4500 values.
    assert np.std([one.joint_offsets_rad for one in drawn]) == pytest.approx(0.001, rel=0.04)
    assert np.std([one.tip_offset_m for one in drawn]) == pytest.approx(0.0005, rel=0.04)
    assert np.std([one.camera_from_nominal[:3, 3] for one in drawn]) == pytest.approx(0.002, rel=0.04)
    angles = [np.arccos((np.trace(one.camera_from_nominal[:3, :3]) - 1.0) / 2.0) for one in drawn]
    assert np.sqrt(np.mean(np.square(angles))) == pytest.approx(np.sqrt(3.0) * 0.01, rel=0.04)


def test_drawn_rotation_is_a_rotation():
    rotation = KinematicErrors(hand_eye_rad=0.2).draw(np.random.default_rng(5)).camera_from_nominal[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0, abs=1e-12)


def test_true_and_nominal_joints_are_each_others_inverse():
    drawn = KinematicErrors(joint_rad=0.01).draw(np.random.default_rng(2))
    q = np.arange(6.0)
    np.testing.assert_allclose(drawn.nominal_joints(drawn.true_joints(q)), q, atol=1e-12)
    assert not np.allclose(drawn.true_joints(q), q)


def test_tip_offset_turns_with_the_shaft():
    drawn = KinematicErrors(tip_m=0.001).draw(np.random.default_rng(2))
    world_from_shaft = np.array([[0.0, -1.0, 0.0, 0.1], [1.0, 0.0, 0.0, 0.2], [0.0, 0.0, 1.0, 0.3], [0.0, 0.0, 0.0, 1.0]])
    x, y, z = drawn.tip_offset_m
    tip = np.array([0.1, 0.2, 0.3])
    np.testing.assert_allclose(tip - drawn.nominal_tip(tip, world_from_shaft), [-y, x, z], atol=1e-15)


def test_nominal_camera_is_off_by_the_drawn_transform():
    drawn = KinematicErrors(hand_eye_m=0.001).draw(np.random.default_rng(2))
    world_from_camera = np.diag([1.0, -1.0, -1.0, 1.0])
    shift = drawn.nominal_camera(world_from_camera)[:3, 3] - world_from_camera[:3, 3]
    np.testing.assert_allclose(shift, world_from_camera[:3, :3] @ drawn.camera_from_nominal[:3, 3], atol=1e-15)


def test_calibration_residual_sets_the_hand_eye_error():
    calibration = CameraCalibration(
        intrinsics=Intrinsics(fx=222.0, fy=222.0, cx=128.0, cy=128.0, width=256, height=256),
        distortion=BrownDistortion(),
        view_errors_px=(0.1,) * 6,
        camera_from_board=np.tile(np.eye(4), (6, 1, 1)),
    )
    errors = KinematicErrors(joint_rad=0.001).with_calibration(calibration, 0.1)
    assert errors.hand_eye_rad == pytest.approx(0.1 / 222.0)
    assert errors.hand_eye_m == pytest.approx(0.01 / 222.0)
    assert errors.joint_rad == 0.001


@pytest.mark.parametrize("name", ["joint_rad", "tip_m", "hand_eye_m", "hand_eye_rad"])
def test_negative_or_huge_errors_are_refused(name):
    for value in (-1e-6, 1.0, float("nan")):
        with pytest.raises(InvalidValueError, match=name):
            KinematicErrors(**{name: value})
