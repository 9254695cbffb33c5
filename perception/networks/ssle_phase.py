"""`ssle-phase`: a network that reads the stripes' phase, triangulates it with the rig that it is given, and refines.

The fixed front end (`PhaseFrontEnd`) demodulates; a U-Net on a half-size latent says for every pixel a coarse depth, which
picks the stripe order among those that the wrapped phase allows, a correction of the phase, a gate between phase and coarse
depth, and a scale. A second stage demodulates once more, now around the phase found: what is left is linear in the remaining
error, and a few convolutions read it off. Depth follows by triangulation, `Z = b / (tau turns)`, inside the network, so that a
loss in millimetres trains all of it.

Whatever the learned part sees and says is in units that mean the same on every rig: turns of phase, or depth relative to
90 mm.
"""

from dataclasses import asdict, dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from laploop.errors import InvalidValueError
from laploop.perception.networks.ssle_phase_front import (
    REFERENCE_M,
    PhaseFilters,
    PhaseFrontEnd,
    RigBatch,
    nearest_turn,
    turn_back,
)

FORMAT = "laploop-ssle-phase-1"
"""Changes whenever the same weights would mean something else."""

_DEPTH_RANGE_M = (0.0145, 0.289)
"""What the network can say at all."""

_COARSE_MAPS, _FINE_MAPS = 4, 2


@dataclass(frozen=True, kw_only=True)
class SslePhaseConfig:
    """Sizes of the network."""

    height: int = 256
    width: int = 256
    widths: tuple[int, ...] = (32, 48, 64, 96, 128)
    """Channels of each level, from half the image's size down by powers of two."""
    windows: tuple[tuple[float, float], ...] = ((0.6, 2.0), (0.35, 1.0), (1.0, 5.0))
    """Demodulation windows: standard deviation along x in periods and along y in pixels. The first gives the phase."""
    refine_width: int = 32
    """Channels of the second stage."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If there are too few levels or windows, or the image cannot be halved often enough.
        """
        if len(self.widths) < 2 or min(self.widths) < 4:
            raise InvalidValueError("widths", self.widths, "two levels or more, each of at least 4 channels")
        if not self.windows or min(min(window) for window in self.windows) <= 0.0:
            raise InvalidValueError("windows", self.windows, "one or more pairs above 0")
        if self.refine_width < 4:
            raise InvalidValueError("refine_width", self.refine_width, "at least 4 channels")
        multiple = 2 ** len(self.widths)
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
    coarse_mm: Tensor
    """Depth that picked the stripe order."""
    first_mm: Tensor
    """Depth before the second stage."""


class SslePhase(nn.Module):
    """Front end, U-Net, triangulation, and the second stage."""

    def __init__(self, config: SslePhaseConfig) -> None:
        """Make the network with random weights from torch's global generator."""
        super().__init__()
        self.config = config
        self.front = PhaseFrontEnd((config.height, config.width), config.windows)
        widths, refine = config.widths, config.refine_width
        self.stem = nn.Sequential(_block(self.front.channels, widths[0]), _block(widths[0], widths[0]))
        self.down = nn.ModuleList(
            nn.Sequential(_block(fine, coarse, stride=2), _block(coarse, coarse)) for fine, coarse in pairwise(widths)
        )
        self.lift = nn.ModuleList(nn.Conv2d(coarse, fine, 1) for fine, coarse in pairwise(widths))
        self.up = nn.ModuleList(nn.Sequential(_block(fine, fine), _block(fine, fine)) for fine in widths[:-1])
        self.head = nn.Conv2d(widths[0], 4 * _COARSE_MAPS, 3, padding=1)
        self.refine = nn.Sequential(_block(widths[0] + _residual_channels(config), refine), _block(refine, refine))
        self.fine_head = nn.Conv2d(refine, 4 * _FINE_MAPS, 3, padding=1)
        with torch.no_grad():
            # Starts as the classical phase in the turn around 90 mm: no correction, gate open at 0.88, scale 0.02 turns.
            self.head.weight.mul_(0.1)
            self.head.bias = nn.Parameter(torch.tensor([0.0] * 4 + [2.0] * 4 + [0.0] * 4 + [-4.0] * 4))
            self.fine_head.weight.mul_(0.1)
            self.fine_head.bias = nn.Parameter(torch.zeros(4 * _FINE_MAPS))

    def prepare(self, rigs: RigBatch) -> PhaseFilters:
        """Compute what depends on the rigs alone, for `forward`; worth keeping where the rig stays."""
        with torch.no_grad():
            return self.front.prepare(rigs)

    def forward(self, image: Tensor, rigs: RigBatch | PhaseFilters) -> SslePhaseOutput:
        """Estimate from images (B, height, width), grey values 0-255 in float32, each with its own rig."""
        filters = self.prepare(rigs) if isinstance(rigs, RigBatch) else rigs
        with torch.no_grad(), torch.autocast(device_type=image.device.type, enabled=False):
            seen = self.front(image, filters)
        level = self.stem(seen.features.contiguous(memory_format=torch.channels_last))
        skips = [level]
        for down in self.down:
            level = down(level)
            skips.append(level)
        for index in reversed(range(len(self.up))):
            lifted = functional.interpolate(self.lift[index](level), scale_factor=2.0, mode="nearest")
            level = self.up[index](skips[index] + lifted)
        correction, gate, coarse, log_scale = functional.pixel_shuffle(self.head(level).float(), 2).unbind(dim=1)
        metre = filters.turns_metre
        coarse_turns = metre / REFERENCE_M * torch.exp(-coarse.clamp(-1.8, 1.15))
        trust = torch.sigmoid(gate)
        turns = trust * (nearest_turn(seen.fraction, coarse_turns) + correction) + (1.0 - trust) * coarse_turns
        first = _limit(turns, metre)
        residual = self._residual(seen.products, first, filters)
        fine = self.fine_head(self.refine(torch.cat([level, residual.to(level.dtype)], dim=1)))
        step, log_factor = functional.pixel_shuffle(fine.float(), 2).unbind(dim=1)
        final = _limit(first + step, metre)
        depth_m = triangulate(final, metre)
        # A scale in turns becomes one in millimetres by the slope of the triangulation, |dZ / dturns| = Z^2 / (b / tau).
        slope = torch.log(1e3 * depth_m.detach().square() / metre)
        return SslePhaseOutput(
            turns=final,
            depth_mm=1e3 * depth_m,
            log_scale=(log_scale + log_factor + slope).clamp(min=-4.0, max=4.0),
            coarse_mm=1e3 * triangulate(coarse_turns, metre),
            first_mm=1e3 * triangulate(first, metre),
        )

    def _residual(self, products: Tensor, turns: Tensor, filters: PhaseFilters) -> Tensor:
        """Demodulate around `turns`; (B, channels, height / 2, width / 2), linear in what the turns lack."""
        with torch.no_grad(), torch.autocast(device_type=products.device.type, enabled=False):
            turned = turn_back(products, turns.detach())
            # Without the last window's contrast, which the first stage has seen; the number of channels is a round one.
            return torch.cat([functional.pixel_unshuffle(turned, 2), self.front.demodulate(turned, filters)[:, :-1]], dim=1)


def triangulate(turns: Tensor, turns_metre: Tensor) -> Tensor:
    """Return z-depth in metres from turns of phase, above 0, and the factor b / tau.

    `turns = (x_c - x_p) / tau`, so this is `Z = b / (x_c - x_p)`.
    """
    return turns_metre / turns


def _limit(turns: Tensor, turns_metre: Tensor) -> Tensor:
    nearest, farthest = turns_metre / _DEPTH_RANGE_M[0], turns_metre / _DEPTH_RANGE_M[1]
    return torch.minimum(torch.maximum(turns, farthest), nearest)


def _residual_channels(config: SslePhaseConfig) -> int:
    return 2 * 4 + 3 * len(config.windows) - 1


def _block(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, stride=stride, padding=1, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(inplace=True),
    )
