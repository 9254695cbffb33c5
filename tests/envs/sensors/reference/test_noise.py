from dataclasses import replace

import numpy as np

from laploop.envs.sensors.reference.noise import ReferenceNoise
from laploop.envs.sensors.reference.optics import ReferenceOptics

WHOLE = ReferenceOptics(sampling="4x4")
REGION = (201, 150, 220, 160)
COLUMN, ROW, WIDTH, HEIGHT = REGION
CROP = (slice(ROW, ROW + HEIGHT), slice(COLUMN, COLUMN + WIDTH))


def test_scale_and_bend_belong_to_the_camera_and_stay_within_their_bounds():
    scales, bends = [], []
    for seed in range(30):
        noise = ReferenceNoise(replace(WHOLE, unit_seed=seed))
        scales.append(noise.scale)
        bends.append(noise.bend_mm)
        assert 0.04 < np.abs(noise.bend_mm).max() <= 0.1
        # Smooth: less than a tenth of the bound between points 10 mm apart at 600 mm.
        assert np.abs(noise.bend_mm[:, 10:] - noise.bend_mm[:, :-10]).max() < 0.01
    assert max(np.abs(scales)) <= 0.002
    assert np.std(scales) > 0.0005
    again = ReferenceNoise(replace(WHOLE, sampling="2x2"))
    assert again.scale == scales[0]
    np.testing.assert_allclose(again.bend_mm.reshape(512, 2, 612, 2).mean(axis=(1, 3)), bends[0], atol=1e-4)


def test_rays_and_bend_of_the_region_are_those_of_the_whole_camera():
    optics = replace(WHOLE, region=REGION)
    np.testing.assert_array_equal(optics.intrinsics.rays, WHOLE.intrinsics.rays[CROP])
    np.testing.assert_array_equal(ReferenceNoise(optics).bend_mm, ReferenceNoise(WHOLE).bend_mm[CROP])
    assert ReferenceNoise(optics).scale == ReferenceNoise(WHOLE).scale
