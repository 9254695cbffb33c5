"""Losses on depth maps of which only some pixels have a truth.

Depths in millimetres; the mask is True where there is a truth. A mask without any True costs nothing and has no gradient.
"""

import torch
from torch import Tensor

from laploop.errors import InvalidValueError, check_range

_SSIM_WINDOW, _SSIM_SIGMA = 11, 1.5
_SSIM_C1, _SSIM_C2 = 0.01**2, 0.03**2
"""Window and constants of Wang et al. 2004, for values from 0 to 1."""


def masked_mean(values: Tensor, mask: Tensor) -> Tensor:
    """Return the mean of the values under the mask; 0 when there are none."""
    # Not a product with the mask: what lies outside may be NaN, and NaN times 0 is NaN.
    return torch.where(mask, values, 0.0).sum() / mask.sum().clamp(min=1)


def masked_l1(estimate: Tensor, truth: Tensor, mask: Tensor) -> Tensor:
    """Return the mean absolute error under the mask, in the unit of the arguments."""
    return masked_mean((estimate - torch.where(mask, truth, 0.0)).abs(), mask)


def ssim_map(first: Tensor, second: Tensor) -> Tensor:
    """Return the structural similarity of images (B, H, W) with values from 0 to 1, for every place of the window inside.

    An 11x11 Gaussian window of standard deviation 1.5, population (co)variances, as Wang et al. 2004 define it.

    Returns:
        (B, H - 10, W - 10).

    Raises:
        InvalidValueError: If the images are smaller than the window.
    """
    if min(first.shape[-2:]) < _SSIM_WINDOW:
        raise InvalidValueError("image (height, width)", tuple(first.shape[-2:]), f"{_SSIM_WINDOW} or more")
    height, width = first.shape[-2:]
    images = torch.stack([first, second, first * first, second * second, first * second], dim=1)
    with torch.autocast(device_type=first.device.type, enabled=False):
        # Products with band matrices: CPUs take ten times as long for the same as a convolution of a single channel.
        along_both = _window_matrix(height, first) @ images.flatten(0, 1) @ _window_matrix(width, first).T
    means = along_both.reshape(-1, 5, *along_both.shape[1:])
    mean1, mean2, square1, square2, product = means.unbind(dim=1)
    variances = square1 - mean1**2 + square2 - mean2**2
    covariance = product - mean1 * mean2
    likeness = (2.0 * mean1 * mean2 + _SSIM_C1) * (2.0 * covariance + _SSIM_C2)
    similarity: Tensor = likeness / ((mean1**2 + mean2**2 + _SSIM_C1) * (variances + _SSIM_C2))
    return similarity


def _window_matrix(size: int, like: Tensor) -> Tensor:
    """Return the matrix (size - 10, size) that slides the normalised Gaussian window over `size` values."""
    place = torch.arange(_SSIM_WINDOW, dtype=like.dtype, device=like.device) - _SSIM_WINDOW // 2
    window = torch.softmax(-0.5 * (place / _SSIM_SIGMA) ** 2, dim=0)
    rows = torch.arange(size - _SSIM_WINDOW + 1, device=like.device)[:, None]
    matrix = torch.zeros(len(rows), size, dtype=like.dtype, device=like.device)
    return matrix.scatter(1, rows + torch.arange(_SSIM_WINDOW, device=like.device), window.expand(len(rows), -1))


def spatial_loss(
    estimate_mm: Tensor, truth_mm: Tensor, mask: Tensor, *, alpha: float, farthest_mm: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Return alpha * L1 + (1 - alpha) * (1 - SSIM), and the two parts, for depths (B, H, W).

    L1 is the mean absolute error under the mask, SSIM that of the masked maps, over the whole image, as the formula has it. The
    text normalises the depths to 0-1 by the data set's range (0 to `farthest_mm`) for SSIM alone; here L1 is normalised as
    well, since millimetres against a number below 1 would leave SSIM without any influence.

    Raises:
        InvalidValueError: If alpha is not from 0 to 1.
    """
    check_range("alpha", alpha, 0.0, 1.0)
    estimate = estimate_mm / farthest_mm
    truth = torch.where(mask, truth_mm, 0.0) / farthest_mm
    l1 = masked_l1(estimate, truth, mask)
    if alpha == 1.0:
        return l1, l1, torch.zeros_like(l1)
    unlike = 1.0 - ssim_map(torch.where(mask, estimate, 0.0), truth).mean()
    return alpha * l1 + (1.0 - alpha) * unlike, l1, unlike


def linear_ramp(start: float, end: float, progress: float) -> float:
    """Return a weight that goes linearly from `start` to `end` over the training, at a fraction of it (0 to 1)."""
    return start + (end - start) * min(1.0, max(0.0, progress))


def vq_loss(codebook_loss: Tensor, commitment_loss: Tensor, commitment: float) -> Tensor:
    """Return codebook + commitment * commitment_loss, as van den Oord et al. 2017 define it.

    The reference framework's default ("legacy") has the weight on the other term, a documented slip; this is not that.
    """
    return codebook_loss + commitment * commitment_loss
