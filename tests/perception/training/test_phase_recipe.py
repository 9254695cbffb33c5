import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from laploop.errors import InvalidValueError
from laploop.perception.networks.depth_network import PhaseOutput
from laploop.perception.training.phase_recipe import phase_loss
from laploop.perception.training.settings import PhaseTraining

TRAINING = PhaseTraining(l1_weight=0.5, coarse_weight=0.2, slip_weight=2.0, within_weight=0.25)


def output(depth_mm, coarse_mm=None, log_scale=0.0, slip_logit=0.0, within_logit=0.0):
    depth = torch.tensor([[depth_mm]])
    coarse = torch.tensor([[coarse_mm or depth_mm]])
    scale, slip, within = (torch.full_like(depth, value) for value in (log_scale, slip_logit, within_logit))
    return PhaseOutput(turns=depth, depth_mm=depth, coarse_mm=coarse, log_scale=scale, slip_logit=slip, within_logit=within)


def entropy(logit, label):
    probability = 1.0 / (1.0 + math.exp(-logit))
    return -math.log(probability if label else 1.0 - probability)


def test_loss_of_pixels_that_do_not_slip_by_hand():
    found = output([100.0, 90.0], [101.0, 85.5], log_scale=1.0, slip_logit=-3.0, within_logit=0.4)
    loss = phase_loss(found, torch.tensor([[[103.0, 89.5]]]), TRAINING)
    likelihood = 0.5 * (3.0 + 0.5) / math.e + 1.0
    absolute = 0.5 * (3.0 + 0.5)
    within = 0.5 * (entropy(0.4, False) + entropy(0.4, True))
    coarse = 0.5 * (2.0 + 4.0)
    wanted = likelihood + 0.5 * absolute + 0.2 * coarse + 2.0 * entropy(-3.0, False) + 0.25 * within
    assert float(loss.total) == pytest.approx(wanted, rel=1e-5)
    assert float(loss.parts["mae_mm"]) == pytest.approx(absolute)


@pytest.mark.parametrize("truth_mm", [math.nan, 25.0, 141.0, 59.0, 115.0])
def test_slips_are_what_has_no_truth_in_the_working_range_or_is_off_by_a_tenth(truth_mm):
    found = output([100.0], slip_logit=1.5)
    loss = phase_loss(found, torch.tensor([[[truth_mm]]]), replace(TRAINING, l1_weight=0.0, coarse_weight=0.0))
    # No likelihood of a slip's error, and no odds of it being within a millimetre.
    assert float(loss.total) == pytest.approx(2.0 * entropy(1.5, True), rel=1e-5)


def test_absolute_error_is_learned_from_slips_too_but_not_far_outside_the_working_range():
    found = output([100.0, 100.0, 100.0])
    loss = phase_loss(found, torch.tensor([[[120.0, 150.0, 30.0]]]), TRAINING)
    assert float(loss.parts["mae_mm"]) == pytest.approx(0.5 * (20.0 + 50.0))


def test_no_gradient_is_nan_where_nothing_is_hit():
    found = output([100.0, 80.0])
    depth = found.depth_mm.requires_grad_()
    phase_loss(replace(found, depth_mm=depth), torch.tensor([[[math.nan, 81.0]]]), TRAINING).total.backward()
    assert torch.isfinite(depth.grad).all()
    assert torch.count_nonzero(depth.grad) == 1


@pytest.mark.parametrize(
    "change",
    [
        {"l1_weight": -1.0},
        {"slip_weight": -1.0},
        {"within_weight": np.nan},
        {"gain_range": 1.0},
        {"painted_share": 1.1},
        {"max_slip": -0.1},
    ],
)
def test_impossible_setting_is_refused(change):
    with pytest.raises(InvalidValueError):
        replace(TRAINING, **change)
