"""A U-Net whose skips are added, from features at half the image's size to features at the same size."""

from collections.abc import Sequence
from itertools import pairwise

from torch import Tensor, nn
from torch.nn import functional


class AdditiveUNet(nn.Module):
    """Two convolutions a level on the way down and up; coarser levels are lifted by a 1x1 convolution and repeated."""

    def __init__(self, inputs: int, widths: Sequence[int]) -> None:
        """Make the network for `inputs` channels; `widths` are those of each level, every one half the size of the last."""
        super().__init__()
        self.stem = nn.Sequential(conv_block(inputs, widths[0]), conv_block(widths[0], widths[0]))
        self.down = nn.ModuleList(
            nn.Sequential(conv_block(fine, coarse, stride=2), conv_block(coarse, coarse)) for fine, coarse in pairwise(widths)
        )
        self.lift = nn.ModuleList(nn.Conv2d(coarse, fine, 1) for fine, coarse in pairwise(widths))
        self.up = nn.ModuleList(nn.Sequential(conv_block(fine, fine), conv_block(fine, fine)) for fine in widths[:-1])

    def forward(self, features: Tensor) -> Tensor:
        """Return features (B, widths[0], h, w) from features (B, inputs, h, w)."""
        level: Tensor = self.stem(features)
        skips = [level]
        for down in self.down:
            level = down(level)
            skips.append(level)
        for index in reversed(range(len(self.up))):
            lifted = functional.interpolate(self.lift[index](level), scale_factor=2.0, mode="nearest")
            level = self.up[index](skips[index] + lifted)
        return level


def conv_block(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    """Return a 3x3 convolution with batch normalisation and ReLU."""
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, stride=stride, padding=1, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(inplace=True),
    )
