"""The prior method (Zuo et al., J. Biomed. Opt. 30(8):086003, 2025): MaskNet times DepthNet.

Two U-Nets see the stripe image: one finds where tissue is, the other how deep, and the product of their outputs is the
depth map. Sizes, losses and resolution are not known to us; the U-Nets here are the usual bilinear ones of five levels from
64 to 512 channels, at full image size, and DepthNet ends in a sigmoid over the depth range.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from laploop.perception.networks.configs import DualUNetConfig
from laploop.perception.networks.depth_network import DepthNetwork
from laploop.perception.networks.latent_unet import LatentUNet
from laploop.perception.networks.vq_vae import image_to_unit


@dataclass(frozen=True, kw_only=True, eq=False)
class DualUNetOutput:
    """The networks' output for a batch, each (B, H, W)."""

    depth_mm: Tensor
    """Depth times the mask, which is 1 where tissue is likelier than not and 0 elsewhere; a product with the probability itself
    would make every depth a few per cent too near."""
    raw_depth_mm: Tensor
    """DepthNet's own output."""
    mask_logit: Tensor
    """MaskNet's output before its sigmoid."""


class DualUNet(DepthNetwork):
    """MaskNet and DepthNet side by side."""

    def __init__(self, config: DualUNetConfig) -> None:
        super().__init__()
        self.config: DualUNetConfig = config
        self.mask_net = LatentUNet(1, 1, config.mask)
        self.depth_net = LatentUNet(1, 1, config.depth)

    def forward(self, image: Tensor) -> DualUNetOutput:
        """Estimate from images (B, height, width), grey values 0-255 in float32."""
        unit = image_to_unit(image).contiguous(memory_format=torch.channels_last)
        mask_logit = self.mask_net(unit)[:, 0].float()
        raw = torch.sigmoid(self.depth_net(unit)[:, 0].float()) * self.config.farthest_mm
        return DualUNetOutput(depth_mm=(mask_logit > 0.0) * raw, raw_depth_mm=raw, mask_logit=mask_logit)
