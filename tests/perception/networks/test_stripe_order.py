import math
from dataclasses import replace

import pytest
import torch

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.perception.geometry import Rig
from laploop.perception.networks.phase_front import RigBatch
from laploop.perception.networks.stripe_order import choose_order, limit_turns, order_limits, triangulate
from laploop.perception.working_range import WORKING_RANGE_MM

NOMINAL = ScopeOptics()
FINE = replace(NOMINAL, baseline_m=0.0055, mask=StripeMask(stripes=28))
COARSE = replace(
    NOMINAL, baseline_m=0.0038, fov_rad=math.radians(75.0), mask=StripeMask(stripes=14, fov_rad=math.radians(75.0))
)
DEPTHS_M = torch.linspace(1e-3 * WORKING_RANGE_MM[0], 1e-3 * WORKING_RANGE_MM[1], 81, dtype=torch.float64)[None, None]


def metre_of(scope):
    return RigBatch.from_rigs([Rig.from_optics(scope)]).turns_metre


def wrapped(turns):
    return turns - torch.round(turns)


@pytest.mark.parametrize("expected_mm", [15.0, 60.0, 90.0, 250.0])
def test_nominal_rig_has_one_order_in_the_working_range_whatever_is_expected(expected_mm):
    metre = metre_of(NOMINAL)
    turns = metre / DEPTHS_M
    expected = (1e3 * metre / expected_mm).expand_as(turns)
    torch.testing.assert_close(choose_order(wrapped(turns), expected, metre), turns)
    low, high = order_limits(metre)
    assert float(high - low) == pytest.approx(1.0)


def test_noise_at_the_borders_of_the_working_range_does_not_wrap_it():
    metre = metre_of(NOMINAL)
    turns = metre / DEPTHS_M
    for noise in (-0.08, 0.08):
        torch.testing.assert_close(choose_order(wrapped(turns + noise), turns, metre), turns + noise)


@pytest.mark.parametrize("scope", [FINE, COARSE])
def test_other_rigs_take_the_order_next_to_what_is_expected(scope):
    metre = metre_of(scope)
    turns = metre / DEPTHS_M
    torch.testing.assert_close(choose_order(wrapped(turns), 1.02 * turns, metre), turns)
    low, high = order_limits(metre)
    found = choose_order(wrapped(turns), torch.full_like(turns, 40.0), metre)
    assert bool(((found >= low - 1e-9) & (found <= high + 1e-9)).all())


def test_gradient_of_the_order_is_that_of_the_fraction():
    fraction = torch.linspace(-0.45, 0.45, 7, dtype=torch.float64, requires_grad=True)
    expected = torch.full((7,), 1.1, dtype=torch.float64)
    metre = torch.tensor(0.0866, dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda value: choose_order(value, expected, metre), (fraction,))


def test_triangulation_is_the_rigs_own():
    rig = Rig.from_optics(NOMINAL)
    depth_m = torch.rand(256, 256, dtype=torch.float64) * 0.15 + 0.05
    turns = (
        torch.from_numpy(rig.camera.rays[..., 0]) - torch.from_numpy(rig.projector_x(depth_m.numpy()))
    ) / rig.mask.period_tan
    torch.testing.assert_close(triangulate(turns[None], metre_of(NOMINAL))[0], depth_m)


def test_gradient_of_the_triangulation_is_right():
    turns = torch.linspace(0.4, 2.0, 7, dtype=torch.float64, requires_grad=True)
    metre = torch.tensor(0.0866, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(triangulate, (turns, metre))


def test_limits_are_those_of_the_depth_a_network_can_express():
    metre = torch.tensor(0.0866)
    cut = limit_turns(torch.tensor([-1.0, 1.0, 100.0]), metre)
    torch.testing.assert_close(triangulate(cut, metre), torch.tensor([0.289, 0.0866, 0.0145]))
