"""The first part of `ssle-phase`: reads the stripes' phase and its order from the image alone.

A U-Net behind the fixed front end (`PhaseFrontEnd`) predicts for every pixel a coarse depth, which picks the stripe order among
those that the wrapped phase allows, a correction of the phase, a gate between phase and coarse depth, and a scale. The stripes
are then demodulated once more, around the phase found: what is left is linear in the remaining error, and a few convolutions
read it off.

All inputs and outputs of the learned part are in units that mean the same on every rig: turns of phase, or depth relative to
90 mm.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from laploop.perception.networks.additive_unet import AdditiveUNet, conv_block
from laploop.perception.networks.ssle_phase_front import (
    REFERENCE_M,
    PhaseFeatures,
    PhaseFilters,
    PhaseFrontEnd,
    limit_turns,
    nearest_turn,
    turn_back,
)

_COARSE_MAPS, _FINE_MAPS = 4, 2


@dataclass(frozen=True, kw_only=True, eq=False)
class PhaseReading:
    """The reader's output for a batch, each (B, height, width)."""

    turns: Tensor
    """Turns of phase, b / (tau Z)."""
    first_turns: Tensor
    """The same before the second demodulation."""
    coarse_turns: Tensor
    """Of the depth that picked the stripe order."""
    log_scale: Tensor
    """Natural logarithm of the scale in turns of a Laplace distribution around `turns`."""


class PhaseReader(nn.Module):
    """U-Net on the front end's features, and what is read off after a second demodulation."""

    def __init__(self, front: PhaseFrontEnd, widths: Sequence[int], refine_width: int) -> None:
        """Make the network behind a front end; `refine_width` channels read the second demodulation."""
        super().__init__()
        self.trunk = AdditiveUNet(front.channels, widths)
        self.head = nn.Conv2d(widths[0], 4 * _COARSE_MAPS, 3, padding=1)
        # Without the last window's contrast, which the trunk has seen; the number of channels is a round one.
        residuals = 2 * 4 + 3 * front.windows - 1
        self.refine = nn.Sequential(conv_block(widths[0] + residuals, refine_width), conv_block(refine_width, refine_width))
        self.fine_head = nn.Conv2d(refine_width, 4 * _FINE_MAPS, 3, padding=1)
        with torch.no_grad():
            # Starts as the classical phase in the turn around 90 mm: no correction, gate open at 0.88, scale 0.02 turns.
            self.head.weight.mul_(0.1)
            self.head.bias = nn.Parameter(torch.tensor([0.0] * 4 + [2.0] * 4 + [0.0] * 4 + [-4.0] * 4))
            self.fine_head.weight.mul_(0.1)
            self.fine_head.bias = nn.Parameter(torch.zeros(4 * _FINE_MAPS))

    def forward(self, seen: PhaseFeatures, front: PhaseFrontEnd, filters: PhaseFilters) -> PhaseReading:
        """Read what the front end has seen of a batch."""
        level = self.trunk(seen.features.contiguous(memory_format=torch.channels_last))
        correction, gate, coarse, log_scale = functional.pixel_shuffle(self.head(level).float(), 2).unbind(dim=1)
        metre = filters.turns_metre
        coarse_turns = metre / REFERENCE_M * torch.exp(-coarse.clamp(-1.8, 1.15))
        trust = torch.sigmoid(gate)
        turns = trust * (nearest_turn(seen.fraction, coarse_turns) + correction) + (1.0 - trust) * coarse_turns
        first = limit_turns(turns, metre)
        with torch.no_grad(), torch.autocast(device_type=level.device.type, enabled=False):
            turned = turn_back(seen.products, first.detach())
            residual = torch.cat([functional.pixel_unshuffle(turned, 2), front.demodulate(turned, filters)[:, :-1]], dim=1)
        fine = self.fine_head(self.refine(torch.cat([level, residual.to(level.dtype)], dim=1)))
        step, log_factor = functional.pixel_shuffle(fine.float(), 2).unbind(dim=1)
        return PhaseReading(
            turns=limit_turns(first + step, metre),
            first_turns=first,
            coarse_turns=coarse_turns,
            log_scale=log_scale + log_factor,
        )
