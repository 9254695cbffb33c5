"""The projector from stripes that a formula draws on planes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.errors import InvalidValueError
from laploop.perception.calibration.projector import (
    UNKNOWNS,
    ProjectorCalibration,
    calibrate_projector,
    calibrated_rig,
    phase_of_mask,
)
from laploop.perception.calibration.results import CameraCalibration
from laploop.perception.carrier import StripeCarrier
from laploop.perception.geometry import Rig
from laploop.perception.reprojection import BrownDistortion

NOMINAL = Rig.from_optics(ScopeOptics())
HALF = (0.05, 0.05)


def camera(distortion=None):
    return CameraCalibration(
        intrinsics=NOMINAL.camera,
        distortion=distortion or BrownDistortion(),
        view_errors_px=(0.0,) * 5,
        camera_from_board=np.tile(np.eye(4), (5, 1, 1)),
    )


def projector(angles_deg=(0.0, 0.0, 0.0), centre_m=(0.005, 0.0, 0.0), period_tan=None, phase_turns=None):
    transform = np.eye(4)
    transform[:3, :3] = Rotation.from_euler("xyz", angles_deg, degrees=True).as_matrix()
    transform[:3, 3] = -transform[:3, :3] @ centre_m
    phase = phase_of_mask(NOMINAL.mask) if phase_turns is None else phase_turns
    return ProjectorCalibration(
        projector_from_camera=transform,
        period_tan=period_tan or NOMINAL.mask.period_tan,
        phase_turns=phase - round(phase),
        view_errors_turns=(0.0,) * 5,
        deviations=dict.fromkeys(UNKNOWNS, 0.0),
    )


def card_poses(count, tilt_deg=25.0):
    rng = np.random.default_rng(2)
    for index in range(count):
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_euler("zxy", rng.uniform(-tilt_deg, tilt_deg, 3), degrees=True).as_matrix()
        pose[:3, 3] = *rng.uniform(-0.005, 0.005, 2), 0.07 + 0.06 * index / count
        yield pose


def draw(true, model, pose):
    rays, normal = model.undistorted_rays(), pose[:3, 2]
    points = rays * ((normal @ pose[:3, 3]) / (rays @ normal))[..., None]
    wave = 100.0 + 50.0 * np.cos(2.0 * np.pi * true.turns(points))
    on_card = (np.abs((points - pose[:3, 3]) @ pose[:3, :3])[..., :2] < HALF).all(axis=-1)
    return np.round(np.where(on_card, wave, 0.0)).astype(np.uint8)


@pytest.mark.parametrize(("distortion", "tolerance"), [(BrownDistortion(), 1.0), (BrownDistortion(k1=-0.15), 4.0)])
def test_a_projector_that_is_turned_and_moved_is_found(distortion, tolerance):
    true = projector((0.4, -0.3, 0.6), (0.0053, 0.0, -0.0004), 1.004 * NOMINAL.mask.period_tan, 0.21)
    model, poses = camera(distortion), list(card_poses(6))
    found = calibrate_projector([draw(true, model, pose) for pose in poses], poses, HALF, model, NOMINAL)
    # Rounded grey values make a thousandth of a turn in each phase, a hundred phases a view and more. A lens that bends the
    # stripes within the window that reads their phase adds a few thousandths, all alike.
    assert found.baseline_m == pytest.approx(0.0053, abs=tolerance * 5e-6)
    assert found.centre_m[2] == pytest.approx(-0.0004, abs=tolerance * 3e-5)
    assert found.centre_m[1] == pytest.approx(0.0, abs=1e-12)
    assert found.period_tan == pytest.approx(true.period_tan, rel=tolerance * 5e-4)
    turn = Rotation.from_matrix(found.projector_from_camera[:3, :3] @ true.projector_from_camera[:3, :3].T)
    assert np.degrees(turn.magnitude()) < tolerance * 0.05
    assert found.error_turns < tolerance * 0.005
    points = model.undistorted_rays()[::16, ::16] * 0.1
    difference = found.turns(points) - true.turns(points)
    assert np.abs(difference - np.round(difference)).max() < tolerance * 3e-3


def test_stripes_and_depth_are_each_others_inverse():
    true = projector((0.4, -0.3, 0.6), (0.0053, 0.0, -0.0004))
    rays = NOMINAL.camera.rays[::16, ::16]
    np.testing.assert_allclose(true.depth_from_turns(rays, true.turns(rays * 0.09)), 0.09, rtol=1e-9)


def test_phase_of_a_mask_is_where_the_classical_estimator_has_it():
    rig = replace(NOMINAL, mask=StripeMask(phase=0.3, duty=0.4))
    # Far away the image is the mask itself.
    turns = StripeCarrier(rig=rig).angle / (2.0 * np.pi)
    assert np.interp(rig.camera.cx, np.arange(256) + 0.5, turns) == pytest.approx(phase_of_mask(rig.mask), abs=1e-9)


def test_rig_of_a_parallel_projector_is_that_projector():
    mask = replace(NOMINAL.mask, phase=0.37)
    true = projector(centre_m=(0.0052, 0.0, 0.0), phase_turns=phase_of_mask(mask))
    found = calibrated_rig(camera(), true, NOMINAL)
    assert found.rig.baseline_m == pytest.approx(0.0052, rel=1e-9)
    assert found.rig.mask.period_tan == pytest.approx(mask.period_tan, rel=1e-9)
    assert found.rig.mask.phase == pytest.approx(0.37, abs=1e-9)
    assert found.misfit_turns < 1e-9
    assert found.distortion_px == 0.0


def test_rig_says_what_a_parallel_projector_leaves_out():
    found = calibrated_rig(camera(BrownDistortion(k1=-0.1)), projector((0.0, 1.0, 0.0)), NOMINAL)
    # One degree of yaw: most of it is a shift of all stripes and a change of their period, the rest is x squared.
    assert 0.001 < found.misfit_turns < 0.1
    assert found.misfit_mm == pytest.approx(found.misfit_turns * 10.0 * NOMINAL.mask.period_tan / 0.05 * 10.0, rel=0.02)
    assert found.distortion_px > 5.0


def test_a_dark_card_is_refused():
    poses = list(card_poses(5))
    with pytest.raises(InvalidValueError, match=r"stripes in view 0 is 0; allowed: at least 50"):
        calibrate_projector([np.zeros((256, 256), np.uint8)] * 5, poses, HALF, camera(), NOMINAL)


def test_too_few_cards_are_refused():
    poses = list(card_poses(4))
    with pytest.raises(InvalidValueError, match="number of views is 4; allowed: at least 5"):
        calibrate_projector([np.zeros((256, 256), np.uint8)] * 4, poses, HALF, camera(), NOMINAL)
