"""The paper's depth network: image encoder and codebook, U-Net between the latents, depth decoder.

Choices where the paper's text is open, beside those in `vq_vae` and `latent_unet`:

- The U-Net predicts the *standardised* depth latent, zero mean and unit deviation in each of its numbers over the training set,
  since the loss compares it with "the standardized reference-depth latent"; the decoder gets it scaled back.
- The target is the quantised latent, so that the prediction is drawn to the codebook.
- The predicted latent goes to the decoder as it is. The text's data flow names no lookup between U-Net and decoder, and a
  rounded latent can only lose depth; `quantize_depth` puts the lookup in.
- Encoder, codebooks and decoder stay as pretrained while the U-Net learns; the training can free the decoder.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from laploop.perception.networks.configs import SsleConfig
from laploop.perception.networks.depth_network import DepthNetwork
from laploop.perception.networks.latent_unet import LatentUNet
from laploop.perception.networks.vector_quantizer import VectorQuantizer
from laploop.perception.networks.vq_vae import Decoder, Encoder, VqVae, image_to_unit, unit_to_depth


@dataclass(frozen=True, kw_only=True, eq=False)
class SsleOutput:
    """The network's output for a batch."""

    depth_mm: Tensor
    """(B, H, W), 0 to `farthest_mm`."""
    latent: Tensor
    """(B, d, h, w), the predicted standardised depth latent."""


class SsleNetwork(DepthNetwork):
    """The network that is run; of what only training needs, it holds nothing but the depth codebook."""

    def __init__(self, config: SsleConfig) -> None:
        super().__init__()
        self.config: SsleConfig = config
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
