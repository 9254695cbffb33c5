"""`ssle-phase`: a network that reads the stripes' phase, and then sees the stripes turned back by that reading and corrects it.

The first part is `compact`; the second one, `PhaseRefiner`, is larger.
"""

from torch import Tensor

from laploop.perception.geometry import Rig
from laploop.perception.networks.compact_unet import CompactUNet, Triangulation
from laploop.perception.networks.configs import SslePhaseConfig
from laploop.perception.networks.depth_network import DepthNetwork, PhaseOutput
from laploop.perception.networks.phase_front import PhaseFeatures, PhaseFilters, RigBatch
from laploop.perception.networks.phase_reader import PhaseReading
from laploop.perception.networks.phase_refiner import PhaseRefiner


class SslePhase(DepthNetwork):
    """Reader, refiner, and triangulation."""

    def __init__(self, config: SslePhaseConfig) -> None:
        super().__init__()
        self.config: SslePhaseConfig = config
        self.compact = CompactUNet(config.reader)
        self.refiner = PhaseRefiner(self.compact.front, config.refiner_widths)
        self.triangulation = Triangulation()

    def context(self, rig: Rig) -> PhaseFilters:
        """Return what depends on a rig alone, on the network's device."""
        return self.compact.context(rig)

    def prepare(self, rigs: RigBatch) -> PhaseFilters:
        """Compute what depends on the rigs alone, for `forward`; worth keeping where the rig stays."""
        return self.compact.prepare(rigs)

    def forward(self, image: Tensor, rigs: RigBatch | PhaseFilters) -> PhaseOutput:
        """Estimate from images (B, height, width), grey values 0-255 in float32, each with its own rig."""
        filters = self.prepare(rigs) if isinstance(rigs, RigBatch) else rigs
        seen = self.compact.see(image, filters)
        return self.refine(seen, self.compact.read(seen, filters), filters)

    def refine(self, seen: PhaseFeatures, reading: PhaseReading, filters: PhaseFilters) -> PhaseOutput:
        """Correct a reading; no gradient goes into it."""
        better = self.refiner(seen, reading, self.compact.front, filters)
        output: PhaseOutput = self.triangulation(better, filters.turns_metre)
        return output
