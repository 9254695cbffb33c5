import numpy as np
import pytest

from laploop.envs.sensors.optics.stripe_optics import STAGE
from laploop.envs.sensors.optics.subsurface import diffuse_reflectance
from laploop.envs.sensors.optics.tissue_classes import TISSUE_CLASSES, tissue_material
from laploop.errors import InvalidValueError, UnknownNameError

BLOOD_PER_M = 2.303 * 30_882.8 * 100.0 * 150.0 / 64_500.0
"""Absorption of oxygenated whole blood with 150 g/l of haemoglobin at 525 nm, from its extinction of 30 882.8 / (cm M)."""


@pytest.mark.parametrize("name", TISSUE_CLASSES)
def test_albedo_and_spread_belong_together(name):
    for albedo in TISSUE_CLASSES[name].albedo:
        material = tissue_material(name, albedo=albedo)
        spread = material.subsurface
        found = diffuse_reflectance(spread.reduced_scattering_per_m, spread.absorption_per_m, spread.refractive_index)
        assert found == pytest.approx(material.albedo) == pytest.approx(albedo)
        # Soft tissue holds up to a tenth of its volume in blood, and fat next to none.
        assert 0.0003 < spread.absorption_per_m / BLOOD_PER_M < 0.1


def test_scattering_falls_with_the_wavelength_as_published():
    at_500, at_1000 = (tissue_material("bowel", wavelength_m=length) for length in (500e-9, 1000e-9))
    assert at_500.subsurface.reduced_scattering_per_m == pytest.approx(1650.0)
    assert at_1000.subsurface.reduced_scattering_per_m == pytest.approx(1650.0 * 2.0**-1.24)


def test_lines_are_about_a_millimetre_wide_widest_on_fat():
    def line_width(name):
        x = np.linspace(0.0, 0.005, 5001)
        gaussians = tissue_material(name).subsurface.gaussians
        line = sum(weight / sigma * np.exp(-0.5 * (x / sigma) ** 2) for weight, sigma in gaussians)
        return 2.0 * x[np.argmax(line < 0.5 * line[0])]

    widths = {name: line_width(name) for name in TISSUE_CLASSES}
    assert all(0.0009 < width < 0.0017 for width in widths.values())
    assert max(widths, key=widths.get) == "fat"


def test_gloss_comes_from_the_surface():
    material = tissue_material("liver", surface=STAGE)
    assert (material.reflectance, material.roughness) == (STAGE.reflectance, STAGE.roughness)
    assert material.albedo == pytest.approx(0.1)


def test_unknown_tissue_and_impossible_albedo_are_refused():
    with pytest.raises(UnknownNameError, match="bowel"):
        tissue_material("bowl")
    with pytest.raises(InvalidValueError, match=r"albedo of liver.*0\.05 to 0\.15"):
        tissue_material("liver", albedo=0.6)
