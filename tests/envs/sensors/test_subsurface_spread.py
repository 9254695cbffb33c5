from dataclasses import replace

import numpy as np
import pytest

from laploop.assets.stripe_mask import StripeMask
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.optics.stripe_optics import TISSUE, StripeOptics
from laploop.envs.sensors.optics.subsurface import Subsurface, dipole_transfer
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.envs.sensors.tracing.scene_geometry import SceneGeometry

SHARP = StripeOptics(glare_fraction=0.0, cavity_fraction=0.0, lens_blur_px=0.0, tissue=replace(TISSUE, subsurface=Subsurface()))
GAUSSIAN = Subsurface(profile="gaussian", fwhm_m=0.0012)
DIPOLE = Subsurface(profile="dipole", reduced_scattering_per_m=1000.0, absorption_per_m=150.0)


@pytest.fixture(scope="module")
def clear_camera(rig):
    return StripeCamera(replace(rig, mask=StripeMask(profile=(1.0,))), SHARP)


def with_tissue(**changes):
    return replace(SHARP, tissue=replace(SHARP.tissue, **changes))


def electrons_of(camera, scene, optics):
    camera.set_optics(optics)
    camera.attach_geometry(scene)
    return camera.capture(None, np.eye(4), None).electrons.astype(float)


def joined(*scenes):
    """One scene of several planes of four points each."""
    return SceneGeometry(
        points=np.concatenate([scene.points for scene in scenes]),
        triangles=np.concatenate([scene.triangles + 4 * k for k, scene in enumerate(scenes)]),
        object_ids=np.concatenate([scene.object_ids for scene in scenes]),
    )


@pytest.mark.parametrize("z", [0.05, 0.07, 0.1])
@pytest.mark.parametrize("subsurface", [GAUSSIAN, DIPOLE])
def test_stripes_lose_what_the_profile_transfers_not(camera, rig, make_plane, z, subsurface):
    plane = make_plane(z, object_id=ObjectId.TISSUE)
    amplitude = []
    period_px = rig.mask.period_tan * rig.camera.fx
    for spread in (Subsurface(), subsurface):
        optics = with_tissue(subsurface=spread, reflectance=0.0)
        row = electrons_of(camera, plane, replace(optics, vignetting_exponent=0.0))[100:156].mean(axis=0)
        columns = np.arange(128 - round(4.5 * period_px), 128 + round(4.5 * period_px))
        window = np.hanning(len(columns))
        wave = np.exp(-2j * np.pi * columns / period_px)
        amplitude.append(np.abs(np.sum(row[columns] * window * wave)) / np.sum(row[columns] * window))
    frequency = 2.0 * np.pi / (rig.mask.period_tan * z)
    if subsurface is DIPOLE:
        expected = float(dipole_transfer(np.array(frequency), 1000.0, 150.0, 1.37))
    else:
        expected = np.exp(-0.5 * (frequency * 0.0012 / 2.3548) ** 2)
    # The sum of Gaussians is off the dipole by 0.003.
    assert amplitude[1] / amplitude[0] == pytest.approx(expected, rel=0.015, abs=0.006)


@pytest.mark.parametrize("tilt", [0.0, 0.6])
def test_even_light_stays(clear_camera, make_plane, tilt):
    plane = make_plane(0.08, tilt_x=tilt, object_id=ObjectId.TISSUE)
    before, after = (
        electrons_of(clear_camera, plane, with_tissue(subsurface=spread, reflectance=0.0))
        for spread in (Subsurface(), GAUSSIAN)
    )
    middle = np.s_[40:216, 60:196]
    np.testing.assert_allclose(after[middle], before[middle], rtol=3e-3)


def test_light_does_not_leak_across_a_depth_edge(clear_camera, make_plane):
    scene = joined(make_plane(0.1, object_id=ObjectId.TISSUE), make_plane(0.06, half=0.008, object_id=ObjectId.TISSUE))
    before, after = (
        electrons_of(clear_camera, scene, with_tissue(subsurface=spread, reflectance=0.0))
        for spread in (Subsurface(), GAUSSIAN)
    )
    clear_camera.attach_geometry(scene)
    depth = clear_camera.exact(None, np.eye(4)).depth_mm
    plate = depth < 61.0
    np.testing.assert_allclose(after[plate], before[plate], rtol=0.01)
    # Left of the plate the wall is in its shadow.
    shadow = np.zeros_like(plate)
    shadow[110:146, :-1] = plate[110:146, 1:] & ~plate[110:146, :-1]
    assert shadow.sum() == 36
    assert before[shadow].max() == after[shadow].max() == 0.0


def test_nothing_leaks_between_objects_and_hard_ones_keep_their_light(camera, make_plane):
    left, right = make_plane(0.08, object_id=ObjectId.TISSUE), make_plane(0.08)
    left.points[[1, 2], 0] = right.points[[0, 3], 0] = 0.001
    scene = joined(left, right)
    before, after = (electrons_of(camera, scene, with_tissue(subsurface=s)) for s in (Subsurface(), GAUSSIAN))
    card = camera.exact(None, np.eye(4)).object_id == ObjectId.OTHER
    assert 0.3 < card.mean() < 0.7
    np.testing.assert_array_equal(after[card], before[card])
    changed = np.abs(after - before)[:, :126].max()
    assert changed > 0.05 * before.max()


def test_the_albedo_acts_where_light_leaves_and_gloss_stays_where_it_is(clear_camera, make_plane):
    dark, bright = (make_plane(0.08, object_id=ObjectId.TISSUE) for _ in range(2))
    dark.points[[1, 2], 0] = bright.points[[0, 3], 0] = 0.0
    scene = joined(dark, bright)
    scene.albedo_factor[:4] = 0.5
    texture = electrons_of(clear_camera, scene, with_tissue(subsurface=GAUSSIAN, reflectance=0.0))[128]
    assert texture[128] / texture[127] == pytest.approx(2.0, rel=0.01)
    glossy = [electrons_of(clear_camera, scene, with_tissue(subsurface=s, albedo=0.0)) for s in (Subsurface(), GAUSSIAN)]
    assert glossy[0].max() > 0.0
    np.testing.assert_array_equal(*glossy)


def test_a_users_optics_change_the_number_of_gaussians_and_back(camera, make_plane):
    plane = make_plane(0.08, object_id=ObjectId.TISSUE)
    images = [electrons_of(camera, plane, with_tissue(subsurface=s)) for s in (GAUSSIAN, DIPOLE, GAUSSIAN)]
    np.testing.assert_array_equal(images[0], images[2])
    assert np.abs(images[1] - images[0]).max() > 0.01 * images[0].max()
