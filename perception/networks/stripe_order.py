"""Turns of phase, the stripe order that makes them whole, and depth.

A wrapped phase fits one depth a turn. Few of these lie in the working range, with the nominal rig a single one: the order is
chosen among those, so that the phase cannot slip to a neighbouring stripe where the range is shorter than a turn. What a
network puts in the phase's place where it cannot be read is bound by `limit_turns` alone.

Tensors are (B, height, width), `turns_metre` the factor b / tau of every rig, (B, 1, 1).
"""

import torch
from torch import Tensor

from laploop.perception.working_range import WORKING_RANGE_MM

DEPTH_RANGE_M = (0.0145, 0.289)
"""Range of depth that a network can express, by what it guesses where no phase can be read."""

_MARGIN_TURNS = 0.08
"""Turns beyond either end of the working range at least, so that noise does not wrap a depth at its border."""


def order_limits(turns_metre: Tensor) -> tuple[Tensor, Tensor]:
    """Return the least and the greatest turns that a wrapped phase may stand for, at least a turn apart.

    The working range lies in their middle.
    """
    near, far = (1e3 * turns_metre / depth for depth in WORKING_RANGE_MM)
    margin = (0.5 * (1.0 - (near - far))).clamp(min=_MARGIN_TURNS)
    low = torch.maximum(far - margin, turns_metre / DEPTH_RANGE_M[1])
    return low, torch.maximum(near + margin, low + 1.0)


def choose_order(fraction: Tensor, expected: Tensor, turns_metre: Tensor) -> Tensor:
    """Return the turns with this fraction, within `order_limits`, that lie nearest to the expected ones.

    The whole number has no gradient.
    """
    low, high = order_limits(turns_metre)
    within = torch.minimum(torch.maximum(expected, low), high)
    whole = torch.round(within - fraction)
    turns = fraction + whole
    whole = whole + (turns < low).to(whole.dtype) - (turns > high).to(whole.dtype)
    return fraction + whole.detach()


def limit_turns(turns: Tensor, turns_metre: Tensor) -> Tensor:
    """Return the turns cut to those of `DEPTH_RANGE_M`."""
    nearest, farthest = turns_metre / DEPTH_RANGE_M[0], turns_metre / DEPTH_RANGE_M[1]
    return torch.minimum(torch.maximum(turns, farthest), nearest)


def triangulate(turns: Tensor, turns_metre: Tensor) -> Tensor:
    """Return z-depth in metres from turns of phase, above 0.

    `turns = (x_c - x_p) / tau`, so this is `Z = b / (x_c - x_p)`.
    """
    return turns_metre / turns
