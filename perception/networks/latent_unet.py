"""The multi-residual U-Net that turns image latents into depth latents.

Encoder: two 3x3 convolutions a level, halved by max-pooling. Decoder: bilinear enlargement, the encoder's map of that level
beside it, two 3x3 convolutions. The paper defines "multi-residual" only as "a multi-level residual branch that aggregates
decoder features across scales before the final output projection". Built is the nearest published idea, heads of a pyramid:

    y = P(d0 + sum_k up_2^k(H_k(d_k)))

with d0 the finest decoder map, d_k the coarser ones, H_k a 1x1 convolution to d0's width, and P the 1x1
output projection. The H_k start at zero, so that training starts from the plain U-Net.
"""

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from laploop.perception.networks.configs import LatentUNetConfig


def _pair(inputs: int, between: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, between, 3, padding=1, bias=False),
        nn.BatchNorm2d(between),
        nn.ReLU(inplace=True),
        nn.Conv2d(between, outputs, 3, padding=1, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(inplace=True),
    )


class LatentUNet(nn.Module):
    """Maps (B, inputs, h, w) to (B, outputs, h, w)."""

    def __init__(self, inputs: int, outputs: int, config: LatentUNetConfig) -> None:
        super().__init__()
        widths = config.widths
        # The decoder's widths are not in the text; these are the usual ones of a bilinear U-Net: half the encoder's.
        decoded = [widths[0], *(width // 2 for width in widths[1:-1])]
        below = [*decoded[1:], widths[-1]]
        self.stem = _pair(inputs, widths[0], widths[0])
        self.down = nn.ModuleList(_pair(fine, coarse, coarse) for fine, coarse in pairwise(widths))
        levels = zip(below, widths[:-1], decoded, strict=True)
        self.up = nn.ModuleList(_pair(coarse + skip, (coarse + skip) // 2, fine) for coarse, skip, fine in levels)
        self.side = nn.ModuleList(nn.Conv2d(width, decoded[0], 1) for width in decoded[1:])
        self.project = nn.Conv2d(decoded[0], outputs, 1)
        for head in self.side:
            if isinstance(head, nn.Conv2d) and head.bias is not None:
                nn.init.zeros_(head.weight)
                nn.init.zeros_(head.bias)

    def forward(self, latents: Tensor) -> Tensor:
        """Map latents whose sides are multiples of 2 to the number of halvings."""
        level: Tensor = self.stem(latents)
        skips: list[Tensor] = []
        for down in self.down:
            skips.append(level)
            level = down(functional.max_pool2d(level, 2))
        branch: list[Tensor] = []
        for index in reversed(range(len(self.up))):
            level = functional.interpolate(level, scale_factor=2.0, mode="bilinear")
            level = self.up[index](torch.cat([skips[index], level], dim=1))
            if index:
                side = self.side[index - 1](level)
                branch.append(functional.interpolate(side, scale_factor=2.0**index, mode="bilinear"))
        projected: Tensor = self.project(sum(branch, level))
        return projected
