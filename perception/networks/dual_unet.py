"""The prior method (Zuo et al., J. Biomed. Opt. 30(8):086003, 2025): MaskNet times DepthNet.

Two U-Nets see the stripe image: one says where tissue is, the other how deep, and the product of their outputs is the
depth map. Sizes, losses and resolution are not known to us; the U-Nets here are the usual bilinear ones of five levels from
64 to 512 channels, at full image size, and DepthNet ends in a sigmoid over the depth range.
"""

from dataclasses import asdict, dataclass, field

import torch
from torch import Tensor, nn

from laploop.errors import InvalidValueError, UnknownNameError
from laploop.perception.networks.latent_unet import LatentUNet, LatentUNetConfig
from laploop.perception.networks.vq_vae import image_to_unit

FORMAT = "laploop-dual-unet-1"
"""Changes whenever the same weights would mean something else."""


@dataclass(frozen=True, kw_only=True)
class DualUNetConfig:
    """Sizes of the two networks; the defaults are those of a usual U-Net, 31 M parameters in all."""

    mask: LatentUNetConfig = field(default_factory=lambda: LatentUNetConfig(base=64))
    depth: LatentUNetConfig = field(default_factory=lambda: LatentUNetConfig(base=64))
    farthest_mm: float = 250.0
    """The depth network's sigmoid ends there; it starts at 0."""
    height: int = 256
    width: int = 256

    def __post_init__(self) -> None:
        """Check that the image divides.

        Raises:
            InvalidValueError: If it does not, or the range is empty.
        """
        if not self.farthest_mm > 0.0:
            raise InvalidValueError("farthest_mm", self.farthest_mm, "above 0 mm")
        step = max(self.mask.shrink, self.depth.shrink)
        if self.height % step or self.width % step or min(self.height, self.width) < step:
            raise InvalidValueError("image (height, width)", (self.height, self.width), f"multiples of {step}")

    @classmethod
    def named(cls, size: str, *, height: int = 256, width: int = 256) -> "DualUNetConfig":
        """Return a size by name: `paper`, `small` for one CPU core, `tiny` for tests.

        Raises:
            UnknownNameError: If there is no such size.
        """
        if size not in _SIZES:
            raise UnknownNameError("size of dual-unet", size, _SIZES)
        mask, depth = _SIZES[size]
        return cls(mask=mask, depth=depth, height=height, width=width)

    @property
    def architecture(self) -> dict[str, object]:
        """What decides whether weights fit, as plain data."""
        return {"format": FORMAT, **asdict(self)}


_SIZES = {
    "paper": (LatentUNetConfig(base=64), LatentUNetConfig(base=64)),
    # Below 16 channels at full size a CPU gains next to no time; six levels reach across the whole image.
    "small": (
        LatentUNetConfig(base=8, multipliers=(1, 2, 4, 4)),
        LatentUNetConfig(base=16, multipliers=(1, 2, 4, 6, 8, 8)),
    ),
    "tiny": (LatentUNetConfig(base=4, multipliers=(1, 2)), LatentUNetConfig(base=8, multipliers=(1, 2, 4))),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class DualUNetOutput:
    """What the networks say about a batch, each (B, H, W)."""

    depth_mm: Tensor
    """Depth times the mask, which is 1 where tissue is likelier than not and 0 elsewhere; a product with the probability itself
    would make every depth a few per cent too near."""
    raw_depth_mm: Tensor
    """What DepthNet alone says."""
    mask_logit: Tensor
    """What MaskNet says, before its sigmoid."""


class DualUNet(nn.Module):
    """MaskNet and DepthNet side by side."""

    def __init__(self, config: DualUNetConfig) -> None:
        """Make the networks with random weights from torch's global generator."""
        super().__init__()
        self.config = config
        self.mask_net = LatentUNet(1, 1, config.mask)
        self.depth_net = LatentUNet(1, 1, config.depth)

    def forward(self, image: Tensor) -> DualUNetOutput:
        """Estimate from images (B, height, width), grey values 0-255 in float32."""
        unit = image_to_unit(image).contiguous(memory_format=torch.channels_last)
        mask_logit = self.mask_net(unit)[:, 0].float()
        raw = torch.sigmoid(self.depth_net(unit)[:, 0].float()) * self.config.farthest_mm
        return DualUNetOutput(depth_mm=(mask_logit > 0.0) * raw, raw_depth_mm=raw, mask_logit=mask_logit)
