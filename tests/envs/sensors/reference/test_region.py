import json
from dataclasses import replace

import numpy as np
import pytest

from laploop.configuration import from_plain, to_plain
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.reference.camera import ReferenceCamera
from laploop.envs.sensors.reference.noise import ReferenceNoise
from laploop.envs.sensors.reference.optics import ReferenceOptics
from laploop.envs.sensors.tracing.scene_geometry import SceneGeometry
from laploop.errors import InvalidValueError

WHOLE = ReferenceOptics(sampling="4x4")
REGION = (201, 150, 220, 160)
COLUMN, ROW, WIDTH, HEIGHT = REGION
CROP = (slice(ROW, ROW + HEIGHT), slice(COLUMN, COLUMN + WIDTH))


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
    whole, region = _capture(WHOLE), _capture(replace(WHOLE, region=REGION))
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
    optics = replace(WHOLE, region=REGION)
    region = _capture(optics, np.random.default_rng(1))
    rays = optics.intrinsics.rays.astype(np.float32)
    np.testing.assert_array_equal(region.xyz, rays * region.z[..., None])


def test_rays_and_bend_of_the_region_are_those_of_the_whole_camera():
    optics = replace(WHOLE, region=REGION)
    np.testing.assert_array_equal(optics.intrinsics.rays, WHOLE.intrinsics.rays[CROP])
    np.testing.assert_array_equal(ReferenceNoise(optics).bend_mm, ReferenceNoise(WHOLE).bend_mm[CROP])
    assert ReferenceNoise(optics).scale == ReferenceNoise(WHOLE).scale


def test_region_of_the_whole_image_changes_no_bit():
    k = WHOLE.intrinsics
    full = replace(WHOLE, region=(0, 0, k.width, k.height))
    assert full.intrinsics == k
    assert full.window == WHOLE.window
    one, other = (_capture(optics, np.random.default_rng(3)) for optics in (WHOLE, full))
    for name in ("xyz", "z", "rgba", "normals", "snr"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_region_from_json_is_the_same_camera():
    optics = replace(WHOLE, region=REGION)
    assert from_plain(ReferenceOptics, json.loads(json.dumps(to_plain(optics)))) == optics


@pytest.mark.parametrize("region", [(-1, 0, 32, 32), (0, 0, 8, 32), (600, 0, 32, 32), (0, 500, 32, 32), (0, 0, 32)])
def test_region_outside_the_image_is_refused(region):
    with pytest.raises(InvalidValueError, match="region"):
        replace(WHOLE, region=region)
