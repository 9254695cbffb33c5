import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import j0

from laploop.envs.sensors.optics.subsurface import Subsurface, absorption_of, diffuse_reflectance, dipole_transfer
from laploop.errors import InvalidValueError, LaploopError


def test_nothing_spreads_by_default_and_a_gaussian_has_its_width():
    assert Subsurface().gaussians == ((1.0, 0.0),)
    ((weight, sigma),) = Subsurface(profile="gaussian", fwhm_m=0.0014).gaussians
    assert weight == 1.0
    assert np.exp(-0.5 * (0.0007 / sigma) ** 2) == pytest.approx(0.5)


@pytest.mark.parametrize("frequency", [0.0, 300.0, 1080.0, 4000.0])
def test_the_dipoles_transfer_is_the_hankel_transform_of_its_reflectance(frequency):
    scattering, absorption, index = 1000.0, 100.0, 1.37
    transport = scattering + absorption
    decay = np.sqrt(3.0 * absorption * transport)
    inner = -1.440 / index**2 + 0.710 / index + 0.668 + 0.0636 * index
    depths = 1.0 / transport, (1.0 + 4.0 / 3.0 * (1.0 + inner) / (1.0 - inner)) / transport

    def reflectance(radius):
        lengths = [np.hypot(radius, depth) for depth in depths]
        return sum(z * (1.0 + decay * d) * np.exp(-decay * d) / d**3 for z, d in zip(depths, lengths, strict=True))

    def transform(q):
        return quad(lambda r: reflectance(r) * j0(q * r) * r, 0.0, 0.04, limit=2000)[0]

    found = float(dipole_transfer(np.array(frequency), scattering, absorption, index))
    assert found == pytest.approx(transform(frequency) / transform(0.0), abs=1e-4)


@pytest.mark.parametrize(("scattering", "absorption"), [(1000.0, 50.0), (1000.0, 150.0), (1000.0, 500.0), (2000.0, 100.0)])
def test_gaussians_transfer_what_the_dipole_does(scattering, absorption):
    gaussians = Subsurface(profile="dipole", reduced_scattering_per_m=scattering, absorption_per_m=absorption).gaussians
    assert sum(weight for weight, _ in gaussians) == pytest.approx(1.0, abs=1e-12)
    assert [sigma for _, sigma in gaussians] == sorted(sigma for _, sigma in gaussians)
    frequency = 2.0 * np.pi / np.geomspace(0.0005, 0.02, 50)
    fitted = sum(weight * np.exp(-0.5 * (sigma * frequency) ** 2) for weight, sigma in gaussians)
    assert np.abs(fitted - dipole_transfer(frequency, scattering, absorption, 1.37)).max() < 0.006


def test_what_no_tissue_has_is_refused_by_name():
    for field, value in (("profile", "lambert"), ("fwhm_m", -0.001), ("absorption_per_m", 0.0), ("refractive_index", 0.5)):
        with pytest.raises(LaploopError, match=field):
            Subsurface(**{field: value})


@pytest.mark.parametrize(("scattering", "absorption"), [(1000.0, 50.0), (870.0, 600.0), (1800.0, 5.0)])
def test_diffuse_reflectance_is_the_sum_over_the_whole_spot(scattering, absorption):
    index = 1.37
    transport, decay = scattering + absorption, np.sqrt(3.0 * absorption * (scattering + absorption))
    inner = -1.440 / index**2 + 0.710 / index + 0.668 + 0.0636 * index
    depths = 1.0 / transport, (1.0 + 4.0 / 3.0 * (1.0 + inner) / (1.0 - inner)) / transport

    def spot(radius):
        lengths = [np.hypot(radius, depth) for depth in depths]
        parts = sum(z * (1.0 + decay * d) * np.exp(-decay * d) / d**3 for z, d in zip(depths, lengths, strict=True))
        return scattering / transport * parts / (4.0 * np.pi)

    whole = quad(lambda r: 2.0 * np.pi * r * spot(r), 0.0, 0.3, limit=2000, points=[1e-3, 1e-2])[0]
    found = diffuse_reflectance(scattering, absorption, index)
    assert found == pytest.approx(whole, rel=2e-3)
    assert absorption_of(found, scattering, index) == pytest.approx(absorption, rel=1e-6)


def test_an_albedo_that_no_absorption_gives_is_refused():
    with pytest.raises(InvalidValueError, match="albedo"):
        absorption_of(0.99, 1000.0, 1.37)
