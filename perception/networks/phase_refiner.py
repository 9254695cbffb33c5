"""The second part of `ssle-phase`: sees the stripes turned back by a first reading, and corrects it.

Turned back by the right phase, every stripe of every rig looks the same: a constant. What deviates from it is, to first order,
proportional to what the reading lacks, whatever the stripes' count and the baseline. Where the reading is of no use, as in
shadows, a gate lets the depth follow from the surroundings instead.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional

from laploop.perception.networks.additive_unet import AdditiveUNet
from laploop.perception.networks.phase_front import REFERENCE_M, PhaseFeatures, PhaseFilters, PhaseFrontEnd, turn_back
from laploop.perception.networks.phase_reader import PhaseReading
from laploop.perception.networks.stripe_order import limit_turns

_MAPS = 5
_RELIEF_PX = 16
"""Side of the squares whose mean the reading's relief is relative to."""
_RELIEF_GAIN = 20.0
_STEP_TURNS = 0.1
"""Unit of the network's steps."""


class PhaseRefiner(nn.Module):
    """U-Net on the stripes as they look around a reading."""

    def __init__(self, front: PhaseFrontEnd, widths: Sequence[int]) -> None:
        super().__init__()
        self.trunk = AdditiveUNet(_channels(front), widths)
        self.head = nn.Conv2d(widths[0], 4 * _MAPS, 3, padding=1)
        with torch.no_grad():
            # Starts as the reading: no step, gate open at 0.95, its scale and its odds of a slip.
            self.head.weight.mul_(0.1)
            self.head.bias = nn.Parameter(torch.tensor([0.0] * 4 + [3.0] * 4 + [0.0] * 12))

    def forward(self, seen: PhaseFeatures, reading: PhaseReading, front: PhaseFrontEnd, filters: PhaseFilters) -> PhaseReading:
        """Correct a reading; no gradient goes into it."""
        first, metre = reading.turns.detach(), filters.turns_metre
        with torch.no_grad(), torch.autocast(device_type=first.device.type, enabled=False):
            features = self._features(seen, reading, front, filters)
        level = self.trunk(features.contiguous(memory_format=torch.channels_last))
        step, gate, free, log_factor, odds = functional.pixel_shuffle(self.head(level).float(), 2).unbind(dim=1)
        trust = torch.sigmoid(gate)
        elsewhere = metre / REFERENCE_M * torch.exp(-free.clamp(-1.8, 1.15))
        better = trust * (first + _STEP_TURNS * step) + (1.0 - trust) * elsewhere
        return PhaseReading(
            turns=limit_turns(better, metre),
            coarse_turns=elsewhere,
            log_scale=reading.log_scale.detach() + log_factor,
            slip_logit=reading.slip_logit.detach() + odds,
        )

    def _features(self, seen: PhaseFeatures, reading: PhaseReading, front: PhaseFrontEnd, filters: PhaseFilters) -> Tensor:
        turns = reading.turns
        turned = turn_back(seen.products, turns)
        angle = 2.0 * math.pi * turns
        # The carrier turned the same way: where on its stripe a pixel lies.
        cosine, sine = torch.cos(angle), torch.sin(angle)
        stripe = torch.stack(
            [
                filters.wave[:, 0] * cosine - filters.wave[:, 1] * sine,
                filters.wave[:, 0] * sine + filters.wave[:, 1] * cosine,
            ],
            dim=1,
        )
        nearness = torch.log(turns * REFERENCE_M / filters.turns_metre)
        mean = functional.avg_pool2d(nearness[:, None], _RELIEF_PX)
        smooth = functional.interpolate(mean, scale_factor=float(_RELIEF_PX), mode="bilinear")[:, 0]
        relief = (_RELIEF_GAIN * (nearness - smooth)).clamp(-3.0, 3.0)
        fine = torch.cat([seen.normal[:, None], turned, stripe, nearness[:, None], relief[:, None]], dim=1)
        doubts = torch.stack([reading.log_scale + 4.0, reading.slip_logit.clamp(-8.0, 8.0) / 4.0], dim=1)
        return torch.cat(
            [
                functional.pixel_unshuffle(fine, 2),
                functional.avg_pool2d(torch.cat([seen.levels, doubts], dim=1), 2),
                front.demodulate(turned, filters),
                filters.maps.expand(len(turns), -1, -1, -1),
            ],
            dim=1,
        )


def _channels(front: PhaseFrontEnd) -> int:
    return 7 * 4 + 4 + 3 * front.windows + front.MAPS
