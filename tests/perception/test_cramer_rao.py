import math

import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.errors import InvalidValueError
from laploop.perception.cramer_rao import CramerRaoBound, SensorNoise, depth_floor_mm, phase_floor_rad
from laploop.perception.geometry import Rig


@pytest.mark.parametrize(
    ("depth_mm", "contrast", "stripes", "expected_mm"),
    [
        (70.0, 0.58, 20, {500: (0.26, 0.12), 2000: (0.13, 0.06), 5000: (0.08, 0.04)}),
        (100.0, 0.44, 20, {500: (0.72, 0.32), 2000: (0.36, 0.16), 5000: (0.23, 0.10)}),
        (100.0, 0.44, 40, {500: (0.51, 0.23), 2000: (0.26, 0.11), 5000: (0.16, 0.07)}),
        (113.0, 0.40, 20, {500: (1.02, 0.46), 2000: (0.51, 0.23), 5000: (0.32, 0.14)}),
    ],
)
def test_floor_reproduces_the_table_computed_by_hand(depth_mm, contrast, stripes, expected_mm):
    rig = Rig.from_optics(ScopeOptics(mask=StripeMask(stripes=stripes)))
    for electrons, expected in expected_mm.items():
        for rows, value_mm in zip((1, 5), expected, strict=True):
            samples = rows * rig.mask.period_tan * rig.camera.fx
            phase = phase_floor_rad(np.array(electrons), np.array(contrast), 2.5**2, samples)
            floor_mm = float(depth_floor_mm(rig, np.array(depth_mm), phase))
            assert floor_mm == pytest.approx(value_mm, abs=0.006)  # mm; the table has two digits, made from rounded factors


def test_closed_form_is_the_integral():
    mean, contrast, variance = 800.0, 0.5, 40.0
    angle = (np.arange(4096) + 0.5) * 2.0 * np.pi / 4096
    information = np.mean((mean * contrast * np.sin(angle)) ** 2 / (mean * (1.0 + contrast * np.cos(angle)) + variance))
    floor = phase_floor_rad(np.array(mean), np.array(contrast), variance, 13.0)
    assert float(floor) == pytest.approx(1.0 / math.sqrt(13.0 * information), rel=1e-9)


@pytest.mark.parametrize(("mean", "contrast", "read_noise"), [(500.0, 0.44, 2.5), (2000.0, 0.58, 8.0), (150.0, 0.6, 6.0)])
def test_maximum_likelihood_estimate_of_noisy_fringes_attains_the_floor(mean, contrast, read_noise):
    """Mean, amplitude and phase are all unknown to the estimate, which scores with the fringes' own weights."""
    rng = np.random.default_rng(0)
    trials, samples, phase = 20_000, 64, 0.7
    angle = np.arange(samples) * 2.0 * np.pi / 16
    truth = mean * (1.0 + contrast * np.cos(angle + phase))
    counts = rng.poisson(truth, (trials, samples)) + rng.normal(0.0, read_noise, (trials, samples))
    basis = np.stack([np.ones(samples), np.cos(angle), -np.sin(angle)])
    solution = counts @ np.linalg.pinv(basis)
    for _ in range(3):
        weight = 1.0 / np.maximum(solution @ basis + read_noise**2, 1.0)
        normal = np.einsum("ts,is,js->tij", weight, basis, basis)
        right = np.einsum("ts,ts,is->ti", weight, counts, basis)
        solution = np.linalg.solve(normal, right[..., None])[..., 0]
    found = np.arctan2(solution[:, 2], solution[:, 1])
    floor = float(phase_floor_rad(np.array(mean), np.array(contrast), read_noise**2, samples))
    assert abs(found.mean() - phase) < 5.0 * floor / math.sqrt(trials)
    # The spread of a standard deviation from 20 000 trials is 0.5 %; the rest is what is left of finite counts.
    assert found.std() == pytest.approx(floor, rel=0.03)


def test_floor_of_an_image_is_that_of_its_mean_and_contrast(rig):
    depth_mm = np.full((256, 256), 100.0)
    periods = (rig.projector_x(1e-3 * depth_mm) + rig.mask.half_width_tan) / rig.mask.period_tan
    image = np.round(100.0 + 44.0 * np.cos(2.0 * np.pi * (periods - 0.25))).astype(np.uint8)
    noise = SensorNoise()
    floor = CramerRaoBound(rig, noise).sigma_mm(image, depth_mm)
    electrons = 100.0 * noise.electrons_per_grey
    phase = phase_floor_rad(np.array(electrons), np.array(0.44), noise.variance, CramerRaoBound(rig).period_px)
    expected = float(depth_floor_mm(rig, np.array(100.0), phase))
    middle = floor[64:192, 64:192]
    assert np.median(middle) == pytest.approx(expected, rel=0.05)  # the window's reading of the contrast
    five = CramerRaoBound(rig, noise).sigma_mm(image, depth_mm, rows=5)
    np.testing.assert_allclose(middle / five[64:192, 64:192], math.sqrt(5.0), rtol=1e-6)


def test_floor_has_no_meaning_without_depth_without_stripes_and_where_the_sensor_is_full(rig):
    floor = CramerRaoBound(rig)
    depth_mm = np.full((256, 256), 100.0)
    assert np.isnan(floor.sigma_mm(np.zeros((256, 256), np.uint8), depth_mm)).all()
    assert np.isnan(floor.sigma_mm(np.full((256, 256), 255, np.uint8), depth_mm)).all()
    assert np.isnan(floor.sigma_mm(np.full((256, 256), 90, np.uint8), np.full((256, 256), np.nan))).all()


def test_no_contrast_has_an_infinite_floor():
    assert np.isinf(phase_floor_rad(np.array(100.0), np.array(0.0), 1.0, 10.0))


def test_impossible_input_is_refused(rig):
    with pytest.raises(InvalidValueError, match="samples"):
        phase_floor_rad(np.array(1.0), np.array(1.0), 1.0, 0.0)
    with pytest.raises(InvalidValueError, match="variance"):
        phase_floor_rad(np.array(1.0), np.array(1.0), -1.0, 1.0)
    with pytest.raises(InvalidValueError, match="rows"):
        CramerRaoBound(rig).sigma_mm(np.zeros((256, 256), np.uint8), np.ones((256, 256)), rows=0)
    with pytest.raises(InvalidValueError, match="shapes"):
        CramerRaoBound(rig).sigma_mm(np.zeros((256, 256), np.uint8), np.ones((4, 4)))
    with pytest.raises(InvalidValueError, match="full_well_electrons"):
        SensorNoise(full_well_electrons=1.0)
