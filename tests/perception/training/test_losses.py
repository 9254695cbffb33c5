import math

import pytest
import torch
from torchmetrics.functional.image import structural_similarity_index_measure as library_ssim

from laploop.errors import InvalidValueError
from laploop.perception.training.losses import linear_ramp, masked_l1, masked_mean, spatial_loss, ssim_map, vq_loss

NAN = float("nan")


def test_masked_mean_and_error_are_those_computed_by_hand():
    mask = torch.tensor([[True, False], [True, True]])
    assert float(masked_mean(torch.tensor([[1.0, NAN], [2.0, 6.0]]), mask)) == 3.0
    estimate, truth = torch.tensor([[100.0, 5.0], [90.0, 80.0]]), torch.tensor([[103.0, NAN], [85.0, 81.0]])
    assert float(masked_l1(estimate, truth, mask)) == 3.0


def test_empty_mask_costs_nothing_and_pulls_nowhere():
    estimate = torch.full((1, 16, 16), 100.0, requires_grad=True)
    nothing = torch.zeros(1, 16, 16, dtype=torch.bool)
    total, l1, unlike = spatial_loss(estimate, torch.full((1, 16, 16), NAN), nothing, alpha=0.5, farthest_mm=250.0)
    total.backward()
    assert (float(total.detach()), float(l1.detach())) == (0.0, 0.0)
    assert float(unlike.detach()) == pytest.approx(0.0, abs=1e-6)
    assert torch.count_nonzero(estimate.grad) == 0


def test_ssim_is_the_librarys():
    torch.manual_seed(0)
    first = torch.rand(2, 40, 33, dtype=torch.float64)
    second = (first + 0.2 * torch.rand_like(first)).clamp(max=1.0)
    _, whole = library_ssim(
        second[:, None], first[:, None], gaussian_kernel=True, sigma=1.5, kernel_size=11, data_range=1.0, return_full_image=True
    )
    # The library pads by mirroring and has the same window; inside, nothing of the padding is seen.
    torch.testing.assert_close(ssim_map(first, second), whole[:, 0, 5:-5, 5:-5], atol=1e-7, rtol=1e-6)


def test_ssim_has_the_gradient_of_finite_differences():
    torch.manual_seed(1)
    first, second = (torch.rand(1, 12, 11, dtype=torch.float64, requires_grad=True) for _ in range(2))
    assert torch.autograd.gradcheck(ssim_map, (first, second))


def test_picture_too_small_for_the_window_is_refused():
    with pytest.raises(InvalidValueError, match="11 or more"):
        ssim_map(torch.zeros(1, 10, 20), torch.zeros(1, 10, 20))


def test_spatial_loss_weighs_its_parts_and_sees_no_unmasked_pixel():
    torch.manual_seed(2)
    truth = 80.0 + 40.0 * torch.rand(1, 24, 24)
    estimate = truth + 5.0
    mask = torch.ones(1, 24, 24, dtype=torch.bool)
    mask[:, :, :6] = False
    total, l1, unlike = spatial_loss(estimate, truth, mask, alpha=0.7, farthest_mm=250.0)
    assert float(l1) == pytest.approx(5.0 / 250.0, rel=1e-5)
    assert float(unlike) > 0.0
    assert float(total) == pytest.approx(0.7 * float(l1) + 0.3 * float(unlike), rel=1e-6)
    other_truth, other_estimate = truth.masked_fill(~mask, NAN), estimate.masked_fill(~mask, 7.0)
    assert float(spatial_loss(other_estimate, other_truth, mask, alpha=0.7, farthest_mm=250.0)[0]) == float(total)


def test_alpha_outside_a_share_is_refused():
    blank = torch.zeros(1, 12, 12)
    with pytest.raises(InvalidValueError, match="alpha"):
        spatial_loss(blank, blank, blank > 0, alpha=1.5, farthest_mm=250.0)


@pytest.mark.parametrize(("progress", "value"), [(0.0, 0.2), (0.25, 0.4), (1.0, 1.0), (3.0, 1.0), (-1.0, 0.2)])
def test_ramp_is_a_line_that_stops_at_its_ends(progress, value):
    assert math.isclose(linear_ramp(0.2, 1.0, progress), value)


def test_commitment_weight_is_on_the_commitment():
    assert float(vq_loss(torch.tensor(2.0), torch.tensor(4.0), 0.25)) == 3.0
