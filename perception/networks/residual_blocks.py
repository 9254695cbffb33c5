"""Building blocks of the VQ-VAEs: normalisation, residual block, self-attention.

The layout is that of the taming-transformers autoencoder, which the paper trains its VQ-VAEs with.
"""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional


def group_norm(channels: int) -> nn.GroupNorm:
    """Return a normalisation over 32 groups, or over as many as divide a width that 32 does not."""
    return nn.GroupNorm(math.gcd(32, channels), channels, eps=1e-6)


class ResidualBlock(nn.Module):
    """x + f(x), where f is twice: normalise, swish, 3x3 convolution; a 1x1 convolution adapts x where the widths differ."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.norm1 = group_norm(inputs)
        self.conv1 = nn.Conv2d(inputs, outputs, 3, padding=1)
        self.norm2 = group_norm(outputs)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, padding=1)
        self.shortcut = nn.Identity() if inputs == outputs else nn.Conv2d(inputs, outputs, 1)

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, inputs, H, W) to (B, outputs, H, W)."""
        change = self.conv1(functional.silu(self.norm1(x)))
        change = self.conv2(functional.silu(self.norm2(change)))
        changed: Tensor = self.shortcut(x) + change
        return changed


class SelfAttention(nn.Module):
    """x + attention of every pixel to every pixel; one head as wide as the channels.

    Computed by torch's fused attention, which never holds the (H W)^2 matrix where the device has a kernel for it.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.norm = group_norm(channels)
        self.qkv = nn.Conv2d(channels, 3 * channels, 1)
        self.out = nn.Conv2d(channels, channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, C, H, W) to the same shape."""
        batch, channels, height, width = x.shape
        rows = self.qkv(self.norm(x)).flatten(2).transpose(1, 2)
        query, key, value = (part.contiguous()[:, None] for part in torch.chunk(rows, 3, dim=-1))
        mixed = functional.scaled_dot_product_attention(query, key, value)[:, 0]
        projected: Tensor = self.out(mixed.transpose(1, 2).reshape(batch, channels, height, width))
        return x + projected


def middle(channels: int, *, attention: bool) -> nn.Sequential:
    """Return the blocks at the coarsest level: residual, optional attention, residual."""
    attending = [SelfAttention(channels)] if attention else []
    return nn.Sequential(ResidualBlock(channels, channels), *attending, ResidualBlock(channels, channels))
