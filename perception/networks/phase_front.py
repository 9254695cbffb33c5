"""The fixed part of `compact` and `ssle-phase`: demodulation of stripes whose geometry is an input, one rig a sample.

Nothing here is learned and nothing is kept: carrier, windows and maps are computed from the rigs of the batch, with the same
formulas as `StripeCarrier`, so that one network serves every stripe count, phase, duty, baseline and focal length.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from laploop.errors import InvalidValueError
from laploop.perception.carrier import gaussian_matrix
from laploop.perception.geometry import Rig
from laploop.perception.networks.band import along_columns, along_rows, cut_to_band
from laploop.perception.networks.stripe_order import choose_order

RIG_NUMBERS = 9
"""Numbers that describe a rig's geometry, all but the size of its image."""

REFERENCE_M = 0.090
"""Depth next to which the order of the first guess lies."""

_MEAN_PERIODS, _MEAN_ROWS = 0.8, 4.0
_CUT = 1e-5
"""Kernel values below are 0, as in `gaussian_matrix`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RigBatch:
    """The rigs of a batch as one tensor, so that they travel with the images."""

    values: Tensor
    """(B, 9) float64: fx, fy, cx, cy in pixels, baseline in m, half width and period of the mask (tangent), phase, duty."""

    def __post_init__(self) -> None:
        if self.values.ndim != 2 or self.values.shape[1] != RIG_NUMBERS:
            raise InvalidValueError("shape of the rigs' numbers", tuple(self.values.shape), f"(batch, {RIG_NUMBERS})")

    @classmethod
    def from_rigs(cls, rigs: Sequence[Rig]) -> "RigBatch":
        """Gather the numbers of rigs, each as `rig_numbers` returns them."""
        return cls(values=torch.tensor([rig_numbers(rig) for rig in rigs], dtype=torch.float64))

    def column(self, index: int) -> Tensor:
        """Return one number of every rig, (B, 1, 1)."""
        return self.values[:, index, None, None]

    @property
    def turns_metre(self) -> Tensor:
        """The factor b / tau of every rig, (B, 1, 1): turns of phase times depth in metres."""
        return self.column(4) / self.column(6)

    @property
    def period_px(self) -> Tensor:
        """Period of every carrier in pixels, (B, 1, 1)."""
        return self.column(6) * self.column(0)

    def ray_x(self, width: int) -> Tensor:
        """Return x of the rays at the columns' centres, (B, 1, width)."""
        columns = torch.arange(width, dtype=torch.float64, device=self.values.device) + 0.5
        return (columns - self.column(2)) / self.column(0)

    def ray_y(self, height: int) -> Tensor:
        """Return y of the rays at the rows' centres, (B, height, 1)."""
        rows = torch.arange(height, dtype=torch.float64, device=self.values.device) + 0.5
        return (rows[:, None] - self.column(3)) / self.column(1)

    def angle(self, width: int) -> Tensor:
        """Return the carrier's phase in radians at each column's centre, (B, 1, width)."""
        periods = (self.ray_x(width) + self.column(5)) / self.column(6) - self.column(7) - 0.5 * self.column(8)
        return 2.0 * math.pi * periods


def rig_numbers(rig: Rig) -> tuple[float, ...]:
    """Return the nine numbers of a rig, in the order of `RigBatch.values`.

    Raises:
        InvalidValueError: If the mask is not one of regular stripes.
    """
    camera, mask = rig.camera, rig.mask
    if mask.is_drawn:
        raise InvalidValueError("mask", "drawn by an image", "regular stripes, whose phase is known everywhere")
    lens = (camera.fx, camera.fy, camera.cx, camera.cy)
    return (*lens, rig.baseline_m, mask.half_width_tan, mask.period_tan, mask.phase, mask.duty)


@dataclass(frozen=True, kw_only=True, eq=False)
class PhaseFilters:
    """What the front end derives from the rigs alone; computed once where the rig stays the same."""

    turns_metre: Tensor
    """(B, 1, 1)."""
    wave: Tensor
    """cos and -sin of the carrier, (B, 2, 1, width)."""
    mean_x: Tensor
    """(B, width, width) as `cut_to_band` returns it; an image times it is smoothed along x."""
    window_x: Tensor
    """The first demodulation window along x, (B, 1, width, width), likewise."""
    half_windows_x: tuple[Tensor, ...]
    """Every demodulation window along x, averaged over pairs of columns, each (B, 1, width, width / 2), likewise."""
    maps: Tensor
    """The geometry as the network sees it, (B, maps, height / 2, width / 2)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PhaseFeatures:
    """What the front end reads from a batch of images."""

    features: Tensor
    """(B, channels, height / 2, width / 2)."""
    products: Tensor
    """Normalised image times carrier, (B, 2, height, width): the stripes as a phasor, before any window."""
    fraction: Tensor
    """Turns of phase less their unknown whole number, (B, height, width), from -0.5 to 0.5."""
    normal: Tensor
    """The image less its local mean, relative to that, (B, height, width)."""
    levels: Tensor
    """Logarithm of the local mean, and 1 where a pixel is saturated, (B, 2, height, width)."""


class PhaseFrontEnd(nn.Module):
    """Contrast normalisation and demodulation by matrix products, batched over rigs."""

    MAPS = 5

    def __init__(self, size: tuple[int, int], windows: Sequence[tuple[float, float]]) -> None:
        """Prepare for images of `size` (height, width) and windows of (periods along x, pixels along y)."""
        super().__init__()
        self.height, self.width = size
        self._windows = tuple(windows)

        def keep(name: str, sigma: float, average: int) -> None:
            matrix = torch.from_numpy(gaussian_matrix(self.height, sigma))
            matrix = matrix.reshape(self.height // average, average, self.height).mean(dim=1)
            self.register_buffer(name, cut_to_band(matrix.to(torch.float32).mT, _reach(sigma)), persistent=False)

        keep("mean_y", _MEAN_ROWS, 1)
        keep("window_y", self._windows[0][1], 1)
        for index, (_, across) in enumerate(self._windows):
            keep(f"half_window_y{index}", across, 2)

    @property
    def windows(self) -> int:
        """Number of demodulation windows."""
        return len(self._windows)

    @property
    def channels(self) -> int:
        """Feature channels at half size, the maps of the geometry included."""
        return 4 * 4 + 3 * self.windows + 2 + self.MAPS

    def prepare(self, rigs: RigBatch) -> PhaseFilters:
        """Compute carrier, windows and maps of each rig."""
        angle = rigs.angle(self.width)
        wave = torch.stack([torch.cos(angle), -torch.sin(angle)], dim=1)
        periods = [along * rigs.period_px for along, _ in self._windows]
        reaches = [_reach(float(sigma.max())) for sigma in periods]
        windows = [2.0 * _gaussian_matrices(self.width, sigma)[:, None] for sigma in periods]
        halves = [0.5 * (window[..., 0::2] + window[..., 1::2]) for window in windows]
        mean_sigma = _MEAN_PERIODS * rigs.period_px
        return PhaseFilters(
            turns_metre=rigs.turns_metre.float(),
            wave=wave.float(),
            mean_x=cut_to_band(_gaussian_matrices(self.width, mean_sigma), _reach(float(mean_sigma.max()))),
            window_x=cut_to_band(windows[0], reaches[0]),
            half_windows_x=tuple(cut_to_band(half, reach) for half, reach in zip(halves, reaches, strict=True)),
            maps=self._maps(rigs).float(),
        )

    def forward(self, image: Tensor, filters: PhaseFilters) -> PhaseFeatures:
        """Read images (B, height, width) in grey values, float32."""
        mean = along_rows(along_columns(image, self.get_buffer("mean_y")), filters.mean_x)
        normal = (image - mean) / (mean + 4.0)
        products = normal[:, None] * filters.wave
        wave = along_rows(along_columns(products, self.get_buffer("window_y")), filters.window_x)
        fraction = -torch.atan2(wave[:, 1], wave[:, 0]) / (2.0 * math.pi)
        reference = filters.turns_metre / REFERENCE_M
        # In units of inverse depth, 0 at the reference: the same number means the same depth on every rig.
        nearness = choose_order(fraction, reference, filters.turns_metre) / reference - 1.0
        saturated = (image >= 253.0).to(image.dtype)
        levels = torch.stack([torch.log(mean + 4.0) - 4.0, saturated], dim=1)
        fine = torch.cat([normal[:, None], turn_back(products, fraction), nearness[:, None]], dim=1)
        features = [
            functional.pixel_unshuffle(fine, 2),
            functional.avg_pool2d(levels, 2),
            self.demodulate(products, filters),
            filters.maps.expand(len(image), -1, -1, -1),
        ]
        return PhaseFeatures(
            features=torch.cat(features, dim=1), products=products, fraction=fraction, normal=normal, levels=levels
        )

    def demodulate(self, products: Tensor, filters: PhaseFilters) -> Tensor:
        """Low-pass phasors (B, 2, height, width) with every window.

        Returns:
            Cosine, sine and contrast a window, (B, 3 * windows, height / 2, width / 2).
        """
        maps: list[Tensor] = []
        for index, window_x in enumerate(filters.half_windows_x):
            wave = along_rows(along_columns(products, self.get_buffer(f"half_window_y{index}")), window_x)
            contrast = wave.square().sum(dim=1, keepdim=True).sqrt()
            maps += [wave / (contrast + 0.02), contrast]
        return torch.cat(maps, dim=1)

    def _maps(self, rigs: RigBatch) -> Tensor:
        ray_x = functional.avg_pool1d(rigs.ray_x(self.width), 2)
        ray_y = functional.avg_pool1d(rigs.ray_y(self.height).mT, 2).mT
        # The left border of the lit field moves by b / Z; in units of that at the reference, it shows what is unlit.
        border = ((ray_x + rigs.column(5)) * REFERENCE_M / rigs.column(4)).clamp(max=4.0) / 4.0
        per_turn = REFERENCE_M / rigs.turns_metre - 1.0
        numbers = [ray_x, ray_y, border, per_turn, rigs.period_px / 12.0 - 1.0]
        return torch.stack([number.expand(-1, self.height // 2, self.width // 2) for number in numbers], dim=1)


def turn_back(products: Tensor, turns: Tensor) -> Tensor:
    """Turn phasors (B, 2, height, width) by `turns`: with the right ones, what is left is real and positive.

    The imaginary part of the result is then, to first order, proportional to what the turns lack.
    """
    angle = 2.0 * math.pi * turns
    cosine, sine = torch.cos(angle), torch.sin(angle)
    real, imaginary = products[:, 0], products[:, 1]
    return torch.stack([real * cosine - imaginary * sine, real * sine + imaginary * cosine], dim=1)


def _reach(sigma: float) -> int:
    """Return how many samples from its middle a Gaussian is not 0."""
    return math.floor(sigma * math.sqrt(-2.0 * math.log(_CUT)))


def _gaussian_matrices(size: int, sigma: Tensor) -> Tensor:
    """Return the transposes of `gaussian_matrix(size, sigma)` for each sigma, (B, size, size) of (B, 1, 1)."""
    index = torch.arange(size, device=sigma.device)
    offset = torch.arange(-size + 1, size, dtype=torch.float64, device=sigma.device)
    kernel = torch.exp(-0.5 * (offset / sigma).square())
    kernel = torch.where(kernel < _CUT, 0.0, kernel).float()
    matrix = kernel[:, 0, index[:, None] - index[None, :] + size - 1]
    return matrix / matrix.sum(dim=1, keepdim=True)
