"""`ssle-phase`: a network that reads the stripes' phase, corrects the reading, and triangulates it with the rig it is given.

A first part reads phase and stripe order from the image (`PhaseReader`); a second one sees the stripes turned back by that
reading and corrects it (`PhaseRefiner`). Depth follows by triangulation, `Z = b / (tau turns)`, inside the network, so that a
loss in millimetres trains all of it. The rig is an input: one network serves every regular stripe mask, baseline and lens.
"""

import torch
from torch import Tensor

from laploop.perception.geometry import Rig
from laploop.perception.networks.configs import SslePhaseConfig
from laploop.perception.networks.depth_network import DepthNetwork, PhaseOutput
from laploop.perception.networks.ssle_phase_front import PhaseFeatures, PhaseFilters, PhaseFrontEnd, RigBatch
from laploop.perception.networks.ssle_phase_reader import PhaseReader
from laploop.perception.networks.ssle_phase_refiner import PhaseRefiner


class SslePhase(DepthNetwork):
    """Front end, reader, refiner, and triangulation."""

    def __init__(self, config: SslePhaseConfig) -> None:
        super().__init__()
        self.config: SslePhaseConfig = config
        self.front = PhaseFrontEnd((config.height, config.width), config.windows)
        self.reader = PhaseReader(self.front, config.reader_widths, config.reader_fine_width)
        self.refiner = PhaseRefiner(self.front, config.refiner_widths)

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
        seen = self.see(image, filters)
        reading = self.reader(seen, self.front, filters)
        return self.refine(seen, reading.turns, reading.log_scale, filters)

    def see(self, image: Tensor, filters: PhaseFilters) -> PhaseFeatures:
        """Run the front end, in single precision."""
        with torch.no_grad(), torch.autocast(device_type=image.device.type, enabled=False):
            features: PhaseFeatures = self.front(image, filters)
        return features

    def refine(self, seen: PhaseFeatures, turns: Tensor, log_scale: Tensor, filters: PhaseFilters) -> PhaseOutput:
        """Correct a reading, turns and the logarithm of their scale; no gradient goes into it."""
        better, its_log_scale = self.refiner(seen, turns, log_scale, self.front, filters)
        return triangulated(better, its_log_scale, filters.turns_metre)


def triangulated(turns: Tensor, log_scale: Tensor, turns_metre: Tensor) -> PhaseOutput:
    """Return depth and its scale in millimetres from turns of phase and theirs.

    A scale in turns becomes one in millimetres by the slope of the triangulation, |dZ / dturns| = Z^2 / (b / tau).
    """
    depth_m = triangulate(turns, turns_metre)
    slope = torch.log(1e3 * depth_m.detach().square() / turns_metre)
    return PhaseOutput(turns=turns, depth_mm=1e3 * depth_m, log_scale=(log_scale + slope).clamp(min=-4.0, max=4.0))


def triangulate(turns: Tensor, turns_metre: Tensor) -> Tensor:
    """Return z-depth in metres from turns of phase, above 0, and the factor b / tau.

    `turns = (x_c - x_p) / tau`, so this is `Z = b / (x_c - x_p)`.
    """
    return turns_metre / turns
