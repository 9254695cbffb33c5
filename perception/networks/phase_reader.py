"""Reads the stripes' phase and its order from the image alone: all of `compact`, and the first part of `ssle-phase`.

A U-Net behind the fixed front end (`PhaseFrontEnd`) predicts for every pixel a correction of the wrapped phase, a coarse
depth that picks the stripe order where the working range leaves a choice, a gate between phase and coarse depth, a scale of
the error, and whether the depth is a slip.

All inputs and outputs of the learned part are in units that mean the same on every rig: turns of phase, or depth relative to
90 mm.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from laploop.perception.networks.additive_unet import AdditiveUNet
from laploop.perception.networks.phase_front import REFERENCE_M, PhaseFeatures, PhaseFilters, PhaseFrontEnd
from laploop.perception.networks.stripe_order import choose_order, limit_turns

_MAPS = 5


@dataclass(frozen=True, kw_only=True, eq=False)
class PhaseReading:
    """A reading of a batch, each (B, height, width)."""

    turns: Tensor
    """Turns of phase, b / (tau Z)."""
    coarse_turns: Tensor
    """Of the depth that picked the stripe order."""
    log_scale: Tensor
    """Natural logarithm of the scale in turns of a Laplace distribution around `turns`."""
    slip_logit: Tensor
    """Logarithm of the odds that the depth is a slip: off by more than a tenth, or the true one outside the working range."""


class PhaseReader(nn.Module):
    """U-Net on the front end's features."""

    def __init__(self, front: PhaseFrontEnd, widths: Sequence[int]) -> None:
        super().__init__()
        self.trunk = AdditiveUNet(front.channels, widths)
        self.head = nn.Conv2d(widths[0], 4 * _MAPS, 3, padding=1)
        with torch.no_grad():
            # Starts as the classical phase, order next to 90 mm: no correction, gate open at 0.88, scale 0.02 turns.
            self.head.weight.mul_(0.1)
            self.head.bias = nn.Parameter(torch.tensor([0.0] * 4 + [2.0] * 4 + [0.0] * 4 + [-4.0] * 4 + [-2.0] * 4))

    def forward(self, seen: PhaseFeatures, filters: PhaseFilters) -> PhaseReading:
        """Read what the front end has seen of a batch."""
        level = self.trunk(seen.features.contiguous(memory_format=torch.channels_last))
        # Channel by channel in memory, as what follows goes through them.
        maps = functional.pixel_shuffle(self.head(level).float(), 2).contiguous()
        correction, gate, coarse, log_scale, slip_logit = maps.unbind(dim=1)
        metre = filters.turns_metre
        coarse_turns = metre / REFERENCE_M * torch.exp(-coarse.clamp(-1.8, 1.15))
        trust = torch.sigmoid(gate)
        phase_turns = choose_order(seen.fraction + correction, coarse_turns, metre)
        turns = trust * phase_turns + (1.0 - trust) * coarse_turns
        return PhaseReading(
            turns=limit_turns(turns, metre), coarse_turns=coarse_turns, log_scale=log_scale, slip_logit=slip_logit
        )
