import numpy as np
import pytest

from laploop.envs.sensors.optics.projection_blur import ProjectionBlur, disk_transfer


def test_the_largest_disk_is_that_of_what_is_near_or_far():
    near = ProjectionBlur(sigma_tan=0.01, aperture_m=0.004, focus_m=0.1)
    assert near.largest_radius_tan == pytest.approx(0.002 * (1.0 / 0.015 - 10.0))
    far = ProjectionBlur(sigma_tan=0.01, aperture_m=0.004, focus_m=0.02)
    assert far.largest_radius_tan == pytest.approx(0.002 * 50.0)
    np.testing.assert_allclose(far.radii(5), 0.1 * np.array([0.0, 0.25, 0.5, 0.75, 1.0]))


def test_a_disks_transfer_is_that_of_its_projection_onto_an_axis():
    radius = 0.02
    x = (np.arange(20000) + 0.5) / 10000 * radius - radius
    profile = np.sqrt(radius**2 - x**2)
    for frequency in (0.0, 50.0, 109.0, 191.6, 400.0):
        expected = np.sum(profile * np.cos(frequency * x)) / np.sum(profile)
        assert disk_transfer(radius, np.array([frequency]))[0] == pytest.approx(expected, abs=1e-5)
