"""`ssle-phase`: a network that reads the stripes' phase, puts the reading right, and triangulates it with the rig it is given.

A first part reads phase and stripe order from the image (`PhaseReader`); a second one sees the stripes turned back by that
reading and corrects it (`PhaseRefiner`). Depth follows by triangulation, `Z = b / (tau turns)`, inside the network, so that a
loss in millimetres trains all of it. The rig is an input: one network serves every regular stripe mask, baseline and lens.
"""

from dataclasses import asdict, dataclass

import torch
from torch import Tensor, nn

from laploop.errors import InvalidValueError
from laploop.perception.networks.ssle_phase_front import PhaseFeatures, PhaseFilters, PhaseFrontEnd, RigBatch
from laploop.perception.networks.ssle_phase_reader import PhaseReader
from laploop.perception.networks.ssle_phase_refiner import PhaseRefiner

FORMAT = "laploop-ssle-phase-2"
"""Changes whenever the same weights would mean something else."""


@dataclass(frozen=True, kw_only=True)
class SslePhaseConfig:
    """Sizes of the network."""

    height: int = 256
    width: int = 256
    windows: tuple[tuple[float, float], ...] = ((0.6, 2.0), (0.35, 1.0), (1.0, 5.0))
    """Demodulation windows: standard deviation along x in periods and along y in pixels. The first gives the phase."""
    reader_widths: tuple[int, ...] = (32, 48, 64, 96, 128)
    """Channels of each level of the reader, from half the image's size down by powers of two."""
    reader_fine_width: int = 32
    """Channels that read the second demodulation."""
    refiner_widths: tuple[int, ...] = (48, 64, 96, 128, 160)
    """Channels of each level of the refiner."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If there are too few levels or windows, or the image cannot be halved often enough.
        """
        for name in ("reader_widths", "refiner_widths"):
            widths = getattr(self, name)
            if len(widths) < 2 or min(widths) < 4:
                raise InvalidValueError(name, widths, "two levels or more, each of at least 4 channels")
        if not self.windows or min(min(window) for window in self.windows) <= 0.0:
            raise InvalidValueError("windows", self.windows, "one or more pairs above 0")
        if self.reader_fine_width < 4:
            raise InvalidValueError("reader_fine_width", self.reader_fine_width, "at least 4 channels")
        multiple = max(2 ** max(len(self.reader_widths), len(self.refiner_widths)), 16)
        if min(self.height, self.width) < multiple or self.height % multiple or self.width % multiple:
            raise InvalidValueError("image (height, width)", (self.height, self.width), f"multiples of {multiple}")

    @property
    def architecture(self) -> dict[str, object]:
        """What decides whether weights fit, as plain data."""
        return {"format": FORMAT, **asdict(self)}


@dataclass(frozen=True, kw_only=True, eq=False)
class SslePhaseOutput:
    """What the network says about a batch, each (B, height, width)."""

    turns: Tensor
    """Turns of phase, b / (tau Z)."""
    depth_mm: Tensor
    log_scale: Tensor
    """Natural logarithm of the scale in millimetres of a Laplace distribution around `depth_mm`."""


class SslePhase(nn.Module):
    """Front end, reader, refiner, and triangulation."""

    def __init__(self, config: SslePhaseConfig) -> None:
        """Make the network with random weights from torch's global generator."""
        super().__init__()
        self.config = config
        self.front = PhaseFrontEnd((config.height, config.width), config.windows)
        self.reader = PhaseReader(self.front, config.reader_widths, config.reader_fine_width)
        self.refiner = PhaseRefiner(self.front, config.refiner_widths)

    def prepare(self, rigs: RigBatch) -> PhaseFilters:
        """Compute what depends on the rigs alone, for `forward`; worth keeping where the rig stays."""
        with torch.no_grad():
            return self.front.prepare(rigs)

    def forward(self, image: Tensor, rigs: RigBatch | PhaseFilters) -> SslePhaseOutput:
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

    def refine(self, seen: PhaseFeatures, turns: Tensor, log_scale: Tensor, filters: PhaseFilters) -> SslePhaseOutput:
        """Put a reading, turns and the logarithm of their scale, right; no gradient goes into it."""
        better, its_log_scale = self.refiner(seen, turns, log_scale, self.front, filters)
        return triangulated(better, its_log_scale, filters.turns_metre)


def triangulated(turns: Tensor, log_scale: Tensor, turns_metre: Tensor) -> SslePhaseOutput:
    """Return depth and its scale in millimetres from turns of phase and theirs.

    A scale in turns becomes one in millimetres by the slope of the triangulation, |dZ / dturns| = Z^2 / (b / tau).
    """
    depth_m = triangulate(turns, turns_metre)
    slope = torch.log(1e3 * depth_m.detach().square() / turns_metre)
    return SslePhaseOutput(turns=turns, depth_mm=1e3 * depth_m, log_scale=(log_scale + slope).clamp(min=-4.0, max=4.0))


def triangulate(turns: Tensor, turns_metre: Tensor) -> Tensor:
    """Return z-depth in metres from turns of phase, above 0, and the factor b / tau.

    `turns = (x_c - x_p) / tau`, so this is `Z = b / (x_c - x_p)`.
    """
    return turns_metre / turns
