"""The VQ-VAE of one domain, stripe images or depth maps: encoder, codebook, decoder.

Encoder: 3x3 convolution to the base width; at every level residual blocks, and between levels a strided convolution that
halves the size; residual, self-attention, residual; normalise, swish, 3x3 convolution and 1x1 convolution to the latent. The
decoder mirrors it.

Where the paper's text leaves a choice:

- Attention "at 16x16" cannot be, since with one halving the levels are 256 and 128 pixels wide. Built is the attention of the
  reference framework's middle block, at the coarsest level (128x128), which can be switched off.
- One transposed convolution enlarges the decoder's maps (4x4, stride 2), as in the text, where the reference framework
  repeats pixels and convolves. The text's tanh is built too.
- "Mirrors" is read as: two residual blocks a level in the decoder as well, where the reference framework has three.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from laploop.perception.networks.configs import VqVaeConfig
from laploop.perception.networks.residual_blocks import ResidualBlock, group_norm, middle
from laploop.perception.networks.vector_quantizer import Quantized, VectorQuantizer


class Downsample(nn.Module):
    """A 3x3 convolution with stride 2; the last row and column see one zero beyond the edge."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(channels, channels, 3, stride=2)

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, C, H, W) to (B, C, H / 2, W / 2)."""
        halved: Tensor = self.conv(functional.pad(x, (0, 1, 0, 1)))
        return halved


class Encoder(nn.Module):
    """Maps (B, 1, H, W) to continuous latents (B, latent, H / shrink, W / shrink)."""

    def __init__(self, config: VqVaeConfig) -> None:
        super().__init__()
        width = config.base
        folding = [nn.PixelUnshuffle(config.fold)] if config.fold > 1 else []
        layers: list[nn.Module] = [*folding, nn.Conv2d(config.fold**2, width, 3, padding=1)]
        for level, outputs in enumerate(config.widths):
            if level:
                layers.append(Downsample(width))
            for _ in range(config.blocks):
                layers.append(ResidualBlock(width, outputs))
                width = outputs
        layers += [middle(width, attention=config.attention), group_norm(width), nn.SiLU()]
        layers += [nn.Conv2d(width, config.latent, 3, padding=1), nn.Conv2d(config.latent, config.latent, 1)]
        self.layers = nn.Sequential(*layers)

    def forward(self, x: Tensor) -> Tensor:
        """Encode (B, 1, H, W)."""
        latents: Tensor = self.layers(x)
        return latents


class Decoder(nn.Module):
    """Maps latents (B, latent, h, w) to (B, 1, h * shrink, w * shrink) in -1 to 1."""

    def __init__(self, config: VqVaeConfig) -> None:
        super().__init__()
        width = config.widths[-1]
        layers: list[nn.Module] = [nn.Conv2d(config.latent, config.latent, 1), nn.Conv2d(config.latent, width, 3, padding=1)]
        layers.append(middle(width, attention=config.attention))
        for level, outputs in reversed(list(enumerate(config.widths))):
            for _ in range(config.blocks):
                layers.append(ResidualBlock(width, outputs))
                width = outputs
            if level:
                layers.append(nn.ConvTranspose2d(width, width, 4, stride=2, padding=1))
        unfolding = [nn.PixelShuffle(config.fold)] if config.fold > 1 else []
        layers += [group_norm(width), nn.SiLU(), nn.Conv2d(width, config.fold**2, 3, padding=1), *unfolding, nn.Tanh()]
        self.layers = nn.Sequential(*layers)

    def forward(self, latents: Tensor) -> Tensor:
        """Decode latents."""
        decoded: Tensor = self.layers(latents)
        return decoded


class VqVae(nn.Module):
    """Encoder, quantiser and decoder of one domain, whose values are scaled to -1 to 1."""

    def __init__(self, config: VqVaeConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = Encoder(config)
        self.quantizer = VectorQuantizer(config.entries, config.latent, restart_after=config.restart_after)
        self.decoder = Decoder(config)

    def forward(self, x: Tensor) -> tuple[Tensor, Quantized]:
        """Return the reconstruction of (B, 1, H, W) and what the quantiser did on the way."""
        quantized: Quantized = self.quantizer(self.encoder(x))
        return self.decoder(quantized.values), quantized


def image_to_unit(image: Tensor) -> Tensor:
    """Scale grey values (B, H, W) from 0-255 to (B, 1, H, W) in -1 to 1."""
    return (image[:, None] * (2.0 / 255.0)) - 1.0


def depth_to_unit(depth_mm: Tensor, farthest_mm: float) -> Tensor:
    """Scale depths (B, H, W) from 0 to `farthest_mm` to (B, 1, H, W) in -1 to 1; what is not known becomes the far end."""
    known = torch.nan_to_num(depth_mm, nan=farthest_mm, posinf=farthest_mm, neginf=0.0)
    return known[:, None].clamp(0.0, farthest_mm) * (2.0 / farthest_mm) - 1.0


def unit_to_depth(unit: Tensor, farthest_mm: float) -> Tensor:
    """Undo `depth_to_unit`: (B, 1, H, W) in -1 to 1 becomes millimetres (B, H, W)."""
    return (unit[:, 0].float() + 1.0) * (0.5 * farthest_mm)
