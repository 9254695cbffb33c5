"""`compact`: a U-Net on a half-size latent, in front of it the physics of the stripes.

A fixed front end, made from the rig, normalises the local contrast, multiplies by the carrier and low-passes, which gives
the classical phase and its amplitude. A small U-Net on a latent of half the image's size corrects the phase where it is
wrong (edges, shadows, saturation), and predicts the scale of its error and where the depth is a slip. Depth follows by
triangulation, `Z = b / (tau turns)`, inside the network, so that a loss in millimetres trains all of it. The rig is an input:
one network serves every regular stripe mask, baseline and lens.
"""

from typing import ClassVar

import torch
from torch import Tensor, nn

from laploop.perception.geometry import Rig
from laploop.perception.networks.configs import CompactConfig
from laploop.perception.networks.depth_network import DepthNetwork, PhaseOutput
from laploop.perception.networks.phase_front import PhaseFeatures, PhaseFilters, PhaseFrontEnd, RigBatch
from laploop.perception.networks.phase_reader import PhaseReader, PhaseReading
from laploop.perception.networks.stripe_order import triangulate


class CompactUNet(DepthNetwork):
    """Front end, reader, and triangulation."""

    tolerates_bf16: ClassVar[bool] = True

    def __init__(self, config: CompactConfig) -> None:
        super().__init__()
        self.config: CompactConfig = config
        self.front = PhaseFrontEnd((config.height, config.width), config.windows)
        self.reader = PhaseReader(self.front, config.widths)
        self.triangulation = Triangulation()

    def context(self, rig: Rig) -> PhaseFilters:
        """Return what depends on a rig alone, on the network's device."""
        device = next(self.parameters()).device
        return self.prepare(RigBatch(values=RigBatch.from_rigs([rig]).values.to(device)))

    def prepare(self, rigs: RigBatch) -> PhaseFilters:
        """Compute what depends on the rigs alone, for `forward`; worth keeping where the rig stays."""
        with torch.no_grad():
            return self.front.prepare(rigs)

    def forward(self, image: Tensor, rigs: RigBatch | PhaseFilters) -> PhaseOutput:
        """Estimate from images (B, height, width), grey values 0-255 in float32, each with its own rig."""
        filters = self.prepare(rigs) if isinstance(rigs, RigBatch) else rigs
        reading = self.read(self.see(image, filters), filters)
        output: PhaseOutput = self.triangulation(reading, filters.turns_metre)
        return output

    def see(self, image: Tensor, filters: PhaseFilters) -> PhaseFeatures:
        """Run the front end, in single precision."""
        with torch.no_grad(), torch.autocast(device_type=image.device.type, enabled=False):
            features: PhaseFeatures = self.front(image, filters)
        return features

    def read(self, seen: PhaseFeatures, filters: PhaseFilters) -> PhaseReading:
        """Read what the front end has seen."""
        reading: PhaseReading = self.reader(seen, filters)
        return reading


class Triangulation(nn.Module):
    """Turns of phase to depth in millimetres, and the scale of their error to odds of being within 1 mm.

    The odds fall with the scale; by how much is learned, and fitted anew after a training (`training/confidence.py`), so that
    they agree with what is seen.
    """

    def __init__(self) -> None:
        super().__init__()
        # A Laplace distribution of scale 0.8 mm has even odds, and at half of that 5 to 1.
        self.odds = nn.Parameter(torch.tensor([0.3, 2.0, 0.0]))

    def forward(self, reading: PhaseReading, turns_metre: Tensor) -> PhaseOutput:
        """Return the output for a reading.

        A scale in turns becomes one in millimetres by the slope of the triangulation, |dZ / dturns| = Z^2 / (b / tau).
        """
        depth_m = triangulate(reading.turns, turns_metre)
        slope = torch.log(1e3 * depth_m.detach().square() / turns_metre)
        log_scale_mm = (reading.log_scale + slope).clamp(min=-4.0, max=4.0)
        return PhaseOutput(
            turns=reading.turns,
            depth_mm=1e3 * depth_m,
            coarse_mm=1e3 * triangulate(reading.coarse_turns, turns_metre),
            log_scale=log_scale_mm,
            slip_logit=reading.slip_logit,
            within_logit=within_logit(self.odds, log_scale_mm),
        )


def within_logit(odds: Tensor, log_scale_mm: Tensor) -> Tensor:
    """Return the logarithm of the odds of being within 1 mm: `o0 - o1 s + o2 s^2`, up to where that ceases to fall.

    Args:
        odds: (3,), the coefficients.
        log_scale_mm: Any shape, natural logarithm of the scale in millimetres.
    """
    scale = torch.minimum(log_scale_mm, odds[1] / (2.0 * odds[2].clamp(min=1e-3)))
    return odds[0] - odds[1] * scale + odds[2] * scale.square()
