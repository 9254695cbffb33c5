"""The compact network: a U-Net on a half-size latent, in front of it the physics of the stripes.

A fixed front end, made from the rig, normalises the local contrast, multiplies by the carrier and low-passes, which gives
the classical phase and its amplitude. A small U-Net on a latent of half the image's size corrects the phase where it is
wrong (edges, shadows, the tool, saturation, the wrong turn) and predicts the scale of its own error.

The network works in turns of phase, `b / (tau Z)`; nothing in the learned part knows the baseline, the focal length or the
position of the stripes.
"""

from typing import ClassVar, Self

import torch
from torch import Tensor, nn
from torch.nn import functional

from laploop.errors import InvalidValueError
from laploop.perception.carrier import StripeCarrier, gaussian_matrix
from laploop.perception.geometry import Rig
from laploop.perception.networks.additive_unet import AdditiveUNet
from laploop.perception.networks.configs import CompactConfig
from laploop.perception.networks.depth_network import DepthNetwork, PhaseOutput

_NEAREST_M = 0.057
"""Near end of the turn in which the network is given the classical phase; with the nominal rig it ends at 167 mm."""

_DEPTH_RANGE_M = (0.0145, 0.289)
"""Range of depth that the network can express."""

_OUTPUTS = 4
"""Maps at full size: correction, gate, free estimate, logarithm of the scale."""


class StripeFrontEnd(nn.Module):
    """The fixed part: contrast normalisation and demodulation by matrix products."""

    def __init__(self, rig: Rig, config: CompactConfig) -> None:
        super().__init__()
        camera = rig.camera
        if camera.width % (2 ** len(config.widths)) or camera.height % (2 ** len(config.widths)):
            size = (camera.height, camera.width)
            raise InvalidValueError("image (height, width)", size, f"multiples of {2 ** len(config.widths)}")
        carrier = StripeCarrier(rig=rig)
        angle = torch.from_numpy(carrier.angle)

        def keep(name: str, value: Tensor) -> None:
            self.register_buffer(name, value.to(torch.float32).contiguous(), persistent=False)

        self._farthest_turns = carrier.turns_metre / _NEAREST_M - 1.0
        keep("wave", torch.stack([torch.cos(angle), -torch.sin(angle)])[:, None, :])
        keep("mean_x", torch.from_numpy(gaussian_matrix(camera.width, 0.8 * carrier.period_px).T))
        keep("mean_y", torch.from_numpy(gaussian_matrix(camera.height, 4.0)))
        for index, (along, across) in enumerate(config.windows):
            keep(f"window_x{index}", 2.0 * torch.from_numpy(gaussian_matrix(camera.width, along * carrier.period_px).T))
            keep(f"window_y{index}", torch.from_numpy(gaussian_matrix(camera.height, across)))
        rays = torch.from_numpy(camera.rays[..., :2].transpose(2, 0, 1).copy())
        keep("rays", functional.avg_pool2d(rays[None], 2))
        self._windows = len(config.windows)

    @property
    def channels(self) -> int:
        """Feature channels at half size."""
        return 4 * 4 + 3 * self._windows + 2 + 2

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """Turn images (B, height, width) in grey values into features at half size and the base in turns.

        Returns:
            Features (B, channels, height / 2, width / 2) and the classical phase (B, height, width) in turns.
        """
        mean = self.get_buffer("mean_y") @ image @ self.get_buffer("mean_x")
        normal = (image - mean) / (mean + 4.0)
        products = normal[:, None] * self.get_buffer("wave")
        coarse: list[Tensor] = []
        base = image
        for index in range(self._windows):
            wave = self.get_buffer(f"window_y{index}") @ products @ self.get_buffer(f"window_x{index}")
            contrast = wave.square().sum(dim=1, keepdim=True).sqrt()
            if index == 0:
                turns = torch.atan2(-wave[:, 1], wave[:, 0]) / (2.0 * torch.pi)
                base = self._farthest_turns + torch.remainder(turns - self._farthest_turns, 1.0)
            coarse += [wave / (contrast + 0.02), contrast]
        saturated = (image >= 253.0).to(image.dtype)
        coarse += [torch.log(mean[:, None] + 4.0) - 4.0, saturated[:, None]]
        fine = torch.cat([normal[:, None], products, base[:, None] - 1.0], dim=1)
        features = [
            functional.pixel_unshuffle(fine, 2),
            functional.avg_pool2d(torch.cat(coarse, dim=1), 2),
            self.get_buffer("rays").expand(len(image), -1, -1, -1),
        ]
        return torch.cat(features, dim=1), base


class CompactUNet(DepthNetwork):
    """The whole network: front end, U-Net, and the head that blends physics and a free estimate."""

    # By 0.01 mm in the mean and 0.05 mm in the 99th percentile, where its error is 0.2 to 0.6 mm.
    tolerates_bf16: ClassVar[bool] = True

    @classmethod
    def for_rig(cls, rig: Rig, config: CompactConfig) -> Self:
        """Make the network; the rig is built into its front end."""
        return cls(rig, config)

    def __init__(self, rig: Rig, config: CompactConfig) -> None:
        super().__init__()
        self.config: CompactConfig = config
        self.turns_metre = StripeCarrier(rig=rig).turns_metre
        self.front = StripeFrontEnd(rig, config)
        self.trunk = AdditiveUNet(self.front.channels, config.widths)
        self.head = nn.Conv2d(config.widths[0], 4 * _OUTPUTS, 3, padding=1)
        with torch.no_grad():
            # Starts as the classical phase: no correction, gate open at 0.88, scale 1 mm.
            self.head.weight.mul_(0.1)
            self.head.bias = nn.Parameter(torch.tensor([0.0] * 4 + [2.0] * 4 + [0.0] * 8))

    def forward(self, image: Tensor) -> PhaseOutput:
        """Estimate from images (B, height, width), grey values 0-255 in float32."""
        with torch.no_grad(), torch.autocast(device_type=image.device.type, enabled=False):
            features, base = self.front(image)
        level = self.trunk(features.contiguous(memory_format=torch.channels_last))
        maps = functional.pixel_shuffle(self.head(level).float(), 2)
        correction, gate, free, log_scale = maps.unbind(dim=1)
        trust = torch.sigmoid(gate)
        turns = trust * (base + correction) + (1.0 - trust) * (1.0 + free)
        turns = turns.clamp(min=self.turns_metre / _DEPTH_RANGE_M[1], max=self.turns_metre / _DEPTH_RANGE_M[0])
        return PhaseOutput(turns=turns, depth_mm=1e3 * self.turns_metre / turns, log_scale=log_scale.clamp(min=-4.0, max=4.0))
