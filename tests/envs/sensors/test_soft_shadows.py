from dataclasses import replace

import numpy as np
import pytest

from laploop.assets.stripe_mask import StripeMask
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.optics.presets import optics_preset
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.envs.sensors.optics.subsurface import Subsurface
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.envs.sensors.tracing.scene_geometry import SceneGeometry

OPTICS = StripeOptics(glare_fraction=0.0, cavity_fraction=0.0, lens_blur_px=0.0)


@pytest.fixture(scope="module")
def clear_camera(rig):
    return StripeCamera(replace(rig, mask=StripeMask(profile=(1.0,))), OPTICS)


def screen_before_wall(make_plane, z, edge_m, *, wall=0.1, along="x"):
    """A wall behind a screen at z, which covers everything on the positive side of its edge."""
    back, front = make_plane(wall), make_plane(z)
    axis = 0 if along == "x" else 1
    front.points[:, axis] = np.where(front.points[:, axis] < 0.0, edge_m, 1.0)
    return SceneGeometry(
        points=np.concatenate([back.points, front.points]),
        triangles=np.concatenate([back.triangles, front.triangles + 4]),
        object_ids=ObjectId.OTHER,
    )


def segment_fraction(t):
    """Fraction of a unit disk on the lower side of a line at the distance t from its centre."""
    t = np.clip(t, -1.0, 1.0)
    return 0.5 + (np.arcsin(t) + t * np.sqrt(1.0 - t * t)) / np.pi


@pytest.mark.parametrize("z", [0.03, 0.05, 0.07])
def test_the_border_of_a_shadow_is_the_part_of_the_aperture_that_is_seen(clear_camera, rig, make_plane, z):
    # The screen's edge lies where the camera sees the border of its shadow.
    edge = -0.004
    clear_camera.set_optics(OPTICS)
    clear_camera.attach_geometry(screen_before_wall(make_plane, z, edge))
    capture = clear_camera.capture(None, np.eye(4), None)
    clear_camera.attach_geometry(make_plane(0.1))
    free = clear_camera.capture(None, np.eye(4), None)
    row = slice(120, 136)
    seen = (capture.depth_mm[128] > 99.0) & (np.abs(capture.projector_x[128]) < 0.5)
    fraction = (capture.electrons[row] / free.electrons[row])[:, seen].mean(axis=0)
    # On the aperture the edge is seen from a point of the wall at x along a line through both.
    x = rig.camera.rays[128, seen, 0] * 0.1 - rig.baseline_m
    at_aperture = x + (edge - rig.baseline_m - x) / (1.0 - z / 0.1)
    expected = segment_fraction(at_aperture / (0.5 * OPTICS.projector_aperture_m))
    assert ((expected > 0.02) & (expected < 0.98)).sum() >= (2 if z > 0.06 else 4)
    # Sixteen rays are steps of a sixteenth.
    np.testing.assert_allclose(fraction, expected, atol=0.05)
    assert np.abs(fraction - expected).mean() < 0.01


def test_a_point_for_an_aperture_casts_sharp_shadows(clear_camera, make_plane):
    scene = screen_before_wall(make_plane, 0.05, -0.004)
    values = []
    for aperture in (0.0, 0.0033):
        clear_camera.set_optics(replace(OPTICS, projector_aperture_m=aperture, vignetting_exponent=0.0))
        clear_camera.attach_geometry(scene)
        capture = clear_camera.capture(None, np.eye(4), None)
        wall = (capture.depth_mm > 99.0) & (np.abs(capture.projector_x) < 0.4) & (np.abs(capture.projector_y) < 0.4)
        grey = capture.electrons[wall] / capture.electrons[wall].max()
        values.append(((grey > 0.02) & (grey < 0.4)).sum())
    assert values[0] == 0
    assert values[1] > 200


def test_light_without_a_shadow_is_as_in_the_table(camera, make_plane):
    # A tiny speck at 30 mm, in a corner, makes rays decide for hundreds of pixels that see the whole aperture.
    wall, speck = make_plane(0.1), make_plane(0.03, half=0.0002)
    scene = SceneGeometry(
        points=np.concatenate([wall.points, speck.points]),
        triangles=np.concatenate([wall.triangles, speck.triangles + 4]),
        object_ids=ObjectId.OTHER,
    )
    camera.set_optics(OPTICS)
    images = []
    for geometry in (make_plane(0.1), scene):
        camera.attach_geometry(geometry)
        images.append(camera.capture(None, np.eye(4), None).electrons)
    camera.set_optics(StripeOptics())
    differs = images[0] != images[1]
    assert differs.sum() < 300
    assert differs.sum() > 10


def test_threads_do_not_change_a_bit(rig, make_plane):
    scene = screen_before_wall(make_plane, 0.05, -0.004, along="y")
    scene.object_ids[2:] = ObjectId.TISSUE
    dipole = replace(optics_preset("paper").tissue, subsurface=Subsurface(profile="dipole"))
    for optics in (StripeOptics(), StripeOptics(tissue=dipole)):
        captures = []
        for threads in (1, 2, 3):
            camera = StripeCamera(rig, optics, threads=threads)
            camera.attach_geometry(scene)
            captures.append(camera.capture(None, np.eye(4), np.random.default_rng(0)))
            camera.close()
        for other in captures[1:]:
            np.testing.assert_array_equal(other.electrons, captures[0].electrons)
            np.testing.assert_array_equal(other.image, captures[0].image)
