"""The paper's depth network: image encoder and codebook, U-Net between the latents, depth decoder.

Choices where the paper's text is open, beside those told in `vq_vae` and `latent_unet`:

- The U-Net predicts the *standardised* depth latent, zero mean and unit deviation in each of its numbers over the training set,
  since the loss compares it with "the standardized reference-depth latent"; the decoder gets it scaled back.
- The target is the quantised latent, so that the prediction is drawn to the codebook.
- The predicted latent goes to the decoder as it is. The text's data flow names no lookup between U-Net and decoder, and a
  rounded latent can only lose depth; `quantize_depth` puts the lookup in.
- Encoder, codebooks and decoder stay as pretrained while the U-Net learns; the training can free the decoder.
"""

from dataclasses import asdict, dataclass, field

import torch
from torch import Tensor, nn

from laploop.errors import InvalidValueError, UnknownNameError
from laploop.perception.networks.latent_unet import LatentUNet, LatentUNetConfig
from laploop.perception.networks.vector_quantizer import VectorQuantizer
from laploop.perception.networks.vq_vae import (
    Decoder,
    Encoder,
    VqVae,
    VqVaeConfig,
    image_to_unit,
    unit_to_depth,
)

FORMAT = "laploop-ssle-1"
"""Changes whenever the same weights would mean something else."""


@dataclass(frozen=True, kw_only=True)
class SsleConfig:
    """Sizes of the network; the defaults are the paper's."""

    image: VqVaeConfig = field(default_factory=VqVaeConfig)
    depth: VqVaeConfig = field(default_factory=lambda: VqVaeConfig(entries=1024))
    unet: LatentUNetConfig = field(default_factory=LatentUNetConfig)
    farthest_mm: float = 250.0
    """The tanh's range ends there; it starts at 0."""
    quantize_depth: bool = False
    """Replace the predicted latent by codebook entries before the decoder."""
    height: int = 256
    width: int = 256

    def __post_init__(self) -> None:
        """Check that the parts fit together.

        Raises:
            InvalidValueError: If the latents differ in size or the image does not divide.
        """
        if self.image.shrink != self.depth.shrink:
            shrinks = (self.image.shrink, self.depth.shrink)
            raise InvalidValueError("pixels a latent pixel of image and depth", shrinks, "the same for both")
        if not self.farthest_mm > 0.0:
            raise InvalidValueError("farthest_mm", self.farthest_mm, "above 0 mm")
        step = self.image.shrink * self.unet.shrink
        if self.height % step or self.width % step or min(self.height, self.width) < step:
            raise InvalidValueError("image (height, width)", (self.height, self.width), f"multiples of {step}")

    @classmethod
    def named(cls, size: str, *, height: int = 256, width: int = 256) -> "SsleConfig":
        """Return a size by name: `paper`, `small` for one CPU core, `tiny` for tests.

        Raises:
            UnknownNameError: If there is no such size.
        """
        if size not in _SIZES:
            raise UnknownNameError("size of ssle", size, _SIZES)
        image, depth, unet = _SIZES[size]
        return cls(image=image, depth=depth, unet=unet, height=height, width=width)

    @property
    def architecture(self) -> dict[str, object]:
        """What decides whether weights fit, as plain data."""
        return {"format": FORMAT, **asdict(self)}


_SIZES = {
    "paper": (VqVaeConfig(), VqVaeConfig(entries=1024), LatentUNetConfig()),
    # All at a quarter of the image's size, where a frame costs one CPU core a few hundredths of a second; 16 numbers a latent,
    # since a codebook of 1024 spans no more.
    "small": (
        VqVaeConfig(fold=4, base=32, multipliers=(1,), blocks=1, attention=False, latent=16, entries=1024),
        VqVaeConfig(fold=4, base=24, multipliers=(1,), blocks=1, attention=False, latent=16, entries=1024),
        LatentUNetConfig(base=32, multipliers=(1, 2, 4, 4, 4)),
    ),
    "tiny": (
        VqVaeConfig(base=8, multipliers=(1, 2), blocks=1, attention=False, latent=8, entries=64),
        VqVaeConfig(base=8, multipliers=(1, 2), blocks=1, attention=False, latent=8, entries=64),
        LatentUNetConfig(base=16, multipliers=(1, 2, 2)),
    ),
}

SSLE_SIZES: tuple[str, ...] = tuple(_SIZES)
"""Names of the sizes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SsleOutput:
    """What the network says about a batch."""

    depth_mm: Tensor
    """(B, H, W), 0 to `farthest_mm`."""
    latent: Tensor
    """(B, d, h, w), the predicted standardised depth latent."""


class SsleNetwork(nn.Module):
    """The network that is run; what only training needs of the VQ-VAEs is not in it, but for the depth codebook."""

    def __init__(self, config: SsleConfig) -> None:
        """Make the network with random weights from torch's global generator."""
        super().__init__()
        self.config = config
        image, depth = config.image, config.depth
        self.encoder = Encoder(image)
        self.quantizer = VectorQuantizer(image.entries, image.latent, restart_after=image.restart_after)
        self.unet = LatentUNet(image.latent, depth.latent, config.unet)
        self.depth_quantizer = VectorQuantizer(depth.entries, depth.latent, restart_after=depth.restart_after)
        self.decoder = Decoder(depth)
        self.latent_mean = nn.Buffer(torch.zeros(1, depth.latent, 1, 1))
        self.latent_deviation = nn.Buffer(torch.ones(1, depth.latent, 1, 1))

    def take_pretrained(self, image: VqVae, depth: VqVae, mean: Tensor, deviation: Tensor) -> None:
        """Take over the parts of two trained VQ-VAEs, and the mean and deviation (d,) of the depth's quantised latents."""
        self.encoder.load_state_dict(image.encoder.state_dict())
        self.quantizer.load_state_dict(image.quantizer.state_dict())
        self.depth_quantizer.load_state_dict(depth.quantizer.state_dict())
        self.decoder.load_state_dict(depth.decoder.state_dict())
        self.latent_mean.copy_(mean.reshape(1, -1, 1, 1))
        # A number of the latent that never changes has nothing to predict; 1 keeps it out of the division.
        self.latent_deviation.copy_(torch.where(deviation > 1e-6, deviation, 1.0).reshape(1, -1, 1, 1))

    def standardize(self, latent: Tensor) -> Tensor:
        """Bring a depth latent (B, d, h, w) to zero mean and unit deviation over the training set."""
        return (latent - self.latent_mean) / self.latent_deviation

    def forward(self, image: Tensor) -> SsleOutput:
        """Estimate from images (B, height, width), grey values 0-255 in float32."""
        return self.from_codes(self.quantizer(self.encoder(image_to_unit(image))).values)

    def from_codes(self, codes: Tensor) -> SsleOutput:
        """Estimate from the quantised image latents (B, d, h, w)."""
        latent = self.unet(codes.contiguous(memory_format=torch.channels_last)).float()
        scaled = latent * self.latent_deviation + self.latent_mean
        if self.config.quantize_depth:
            scaled = self.depth_quantizer(scaled).values
        return SsleOutput(depth_mm=unit_to_depth(self.decoder(scaled), self.config.farthest_mm), latent=latent)
