from dataclasses import replace

import numpy as np
import pytest
from scipy.special import erf

from laploop.assets.mask_fabrication import fabricated
from laploop.assets.mask_pattern import encode_pattern
from laploop.assets.stripe_mask import StripeMask
from laploop.envs.sensors.optics.mask_stack import MaskStack
from laploop.envs.sensors.optics.projection_blur import ProjectionBlur
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.envs.sensors.stripe_camera import StripeCamera

HALF = StripeMask().half_width_tan


def grid_of(stack):
    return stack.start + stack.step * np.arange(len(stack.along_y))


def blurred(stack, sigma=0.0):
    """The mask in focus, blurred by a Gaussian."""
    return stack.blurred(ProjectionBlur(sigma_tan=sigma, aperture_m=0.0, focus_m=0.05))[0]


def image_of(rig, mask, plane, optics=None):
    camera = StripeCamera(replace(rig, mask=mask), optics)
    camera.attach_geometry(plane)
    return camera.capture(None, np.eye(4), None)


def test_a_rectangle_blurs_in_closed_form_along_both_axes():
    pattern = np.zeros((256, 256))
    pattern[64:160, 112:144] = 1.0
    stack = MaskStack.from_mask(StripeMask(pattern=encode_pattern(pattern)))
    grid = grid_of(stack)
    top, bottom, left, right = ((k / 128.0 - 1.0) * HALF for k in (64, 160, 112, 144))
    for sigma in (0.0065, 0.017, 0.035):
        width = np.sqrt(2.0) * sigma
        along_x = 0.5 * (erf((grid - left) / width) - erf((grid - right) / width))
        along_y = 0.5 * (erf((grid - top) / width) - erf((grid - bottom) / width))
        # The mean over cells of the grid adds a twelfth of a squared step to the blur's variance: 2 % of it at 0.0065.
        np.testing.assert_allclose(blurred(stack, sigma), np.outer(along_y, along_x), atol=6e-3)


def test_the_dark_surround_blurs_on_all_four_sides():
    stack = MaskStack.from_mask(StripeMask(pattern=encode_pattern(np.ones((8, 8)))))
    grid, transmission = grid_of(stack), blurred(stack, 0.022)
    for profile in (transmission[384], transmission[:, 384]):
        expected = 0.5 * (1.0 - erf((np.abs(grid) - HALF) / (np.sqrt(2.0) * 0.022)))
        np.testing.assert_allclose(profile, expected, atol=4e-3)  # a thousandth of a step's offset from the middle column


def test_upright_stripes_as_a_picture_look_like_the_built_in_ones(rig, make_plane):
    column = (np.arange(1000) + 0.5) / 1000 * 20 % 1.0
    drawn = StripeMask(pattern=encode_pattern(np.tile(np.where(column < 0.5, 1.0, 0.0), (1000, 1))))
    for z in (0.06, 0.1):
        plain, picture = (image_of(rig, mask, make_plane(z, tilt_y=0.3)).electrons for mask in (StripeMask(), drawn))
        # Both tables are looked up linearly between blurs that differ by 0.025 periods.
        np.testing.assert_allclose(picture, plain, atol=6e-3 * plain.max())


def test_the_first_row_of_a_picture_is_at_the_top_and_its_first_column_at_the_left(rig, make_plane):
    pattern = np.zeros((64, 64))
    pattern[8:16, 40:56] = 1.0
    optics = StripeOptics(glare_fraction=0.0, cavity_fraction=0.0)
    spot, clear = (
        image_of(rig, StripeMask(pattern=encode_pattern(p)), make_plane(0.1), optics).electrons.astype(float)
        for p in (pattern, np.ones((2, 2)))
    )
    weights = spot / np.maximum(clear, 0.05 * clear.max())
    y, x = ((np.indices(weights.shape)[axis] + 0.5) * weights for axis in (0, 1))
    # Twelve of 64 rows down and 48 columns along of a field of 60 degrees; the image is 5 mm / 100 mm off along x.
    expected_x = rig.camera.cx + rig.camera.fx * ((48 / 32 - 1) * HALF + 0.05)
    expected_y = rig.camera.cy + rig.camera.fy * (12 / 32 - 1) * HALF
    assert x.sum() / weights.sum() == pytest.approx(expected_x, abs=0.2)  # px
    assert y.sum() / weights.sum() == pytest.approx(expected_y, abs=0.2)


def displacements(mask):
    """Where the edges of the stripes are off from straight ones, (rows, edges), in periods."""
    stack = MaskStack.from_mask(mask)
    sharp = blurred(stack)
    grid, half_period = grid_of(stack), 0.5 * mask.period_tan
    rows = np.abs(grid) < 0.9 * HALF
    edges = -HALF + half_period * np.arange(4, 36)
    found = []
    for k, edge in enumerate(edges):
        # The transmission's integral over half a stripe on either side says where the edge between is.
        window = np.abs(grid - edge) <= 0.5 * half_period
        area = sharp[np.ix_(rows, window)].sum(axis=1)
        shift = (area - area.mean()) * stack.step
        found.append(shift if k % 2 == 0 else -shift)
    return np.stack(found, axis=1) / mask.period_tan, stack.step / mask.period_tan


def test_edges_wander_by_their_standard_deviation_over_their_correlation_length():
    mask = StripeMask(edge_wander=0.05, edge_correlation=0.4, edge_seed=4)
    shift, step = displacements(mask)
    # 32 edges of about 36 correlation lengths each: a statistical error of 2 %.
    assert shift.std() == pytest.approx(0.05, rel=0.06)
    lag = round(0.4 / step)
    correlation = np.mean(shift[lag:] * shift[:-lag]) / np.mean(shift**2)
    assert correlation == pytest.approx(np.exp(-0.5 * (lag * step / 0.4) ** 2), abs=0.06)
    neighbours = np.corrcoef(shift, rowvar=False)[np.arange(31), np.arange(1, 32)]
    assert abs(neighbours.mean()) < 0.12


def test_specimens_of_a_route_differ_by_their_seed_alone():
    first, again, other = (blurred(MaskStack.from_mask(fabricated(StripeMask(), "printed", seed)), 0.01) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.05


def test_a_printed_mask_keeps_its_duty_and_loses_little_contrast(rig, make_plane):
    contrast, mean = {}, {}
    for name, mask in (("ideal", StripeMask()), *((r, fabricated(StripeMask(), r)) for r in ("chrome", "printed"))):
        electrons = image_of(rig, mask, make_plane(0.085)).electrons[60:196, 78:178]
        row = electrons.mean(axis=0)
        contrast[name] = np.abs(np.diff(row)).mean() / row.mean()
        mean[name] = electrons.mean()
    assert 1.0 >= contrast["chrome"] / contrast["ideal"] > 0.99
    # exp(-2 (pi s)^2) for s of 0.01 and 0.02 periods together is 0.99; the mean over 136 rows keeps some of the wandering.
    assert contrast["printed"] / contrast["ideal"] == pytest.approx(0.99, abs=0.02)
    assert mean["printed"] == pytest.approx(mean["ideal"], rel=0.01)
