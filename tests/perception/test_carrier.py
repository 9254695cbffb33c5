import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.perception.carrier import StripeCarrier, gaussian_matrix
from laploop.perception.geometry import Rig


def test_period_of_twenty_stripes_over_256_pixels_is_12_8_pixels(rig):
    assert StripeCarrier(rig=rig).period_px == pytest.approx(256 / 20)


def test_one_turn_of_phase_spans_60_to_195_mm(rig):
    carrier = StripeCarrier(rig=rig)
    turns = carrier.turns_metre / np.array([0.060, 0.195])
    assert turns[0] - turns[1] == pytest.approx(1.0, abs=0.002)  # turns; the page of facts rounds 195 mm


@pytest.mark.parametrize("phase", [0.0, 0.3, -0.2])
@pytest.mark.parametrize("duty", [0.5, 0.3])
def test_bright_stripes_are_centred_where_the_angle_is_a_whole_number_of_turns(phase, duty):
    mask = StripeMask(phase=phase, duty=duty)
    rig = Rig.from_optics(ScopeOptics(mask=mask))
    x = rig.camera.rays[0, :, 0]
    angle = StripeCarrier(rig=rig).angle
    # By the mask's own words: stripe k is bright from the left edge + (k + phase) periods on, for duty periods.
    centres = -mask.half_width_tan + (np.arange(2, 18) + mask.phase + 0.5 * mask.duty) * mask.period_tan
    at_centre = np.interp(centres, x, angle) / (2.0 * np.pi)
    np.testing.assert_allclose(at_centre, np.round(at_centre), atol=1e-9)


def test_difference_of_camera_and_mask_phase_is_the_turns_of_depth(rig):
    carrier = StripeCarrier(rig=rig)
    depth = np.full((rig.camera.height, rig.camera.width), 0.083)
    camera_x, mask_x = rig.camera.rays[..., 0], rig.projector_x(depth)
    turns = (camera_x - mask_x) / rig.mask.period_tan
    np.testing.assert_allclose(turns, carrier.turns_metre / depth, rtol=1e-12)


def test_rows_of_a_gaussian_matrix_sum_to_one_and_smooth_a_line_without_bias_inside():
    matrix = gaussian_matrix(100, 4.0)
    np.testing.assert_allclose(matrix.sum(axis=1), 1.0, rtol=1e-12)
    line = np.arange(100.0)
    np.testing.assert_allclose((matrix @ line)[20:80], line[20:80], atol=1e-9)
