"""Ranges within which real scopes of this kind differ in their geometry, and scopes drawn from them."""

import math
from dataclasses import replace

import numpy as np

from laploop.assets.ranges import Span, check_ordered
from laploop.assets.scope_optics import Baseline, ScopeOptics
from laploop.assets.stripe_mask import Duty, FieldOfView, Phase, Stripes
from laploop.configuration import configuration


@configuration
class ScopeRanges:
    """Ranges of channels, field of view and mask, drawn from evenly, both ends included.

    Channel distances from 3.8 to 5.5 mm are those of 12 mm stereo laparoscopes (4.3 mm in a da Vinci data set, 5 mm in Ellis et
    al., Surg Endosc 2008) with manufacturing tolerance; full fields of view from 55 to 75 degrees those of such scopes. Stripe
    counts surround the optimum of 20 that Zuo et al. (J Biomed Opt 30(8):086003, 2025) report. The range of the duty is our
    choice for a mask designed for 0.5.

    A range with low = high fixes its quantity.
    """

    baseline_m: Span[Baseline] = (0.0038, 0.0055)
    """From camera to projector."""
    fov_rad: Span[FieldOfView] = (math.radians(55.0), math.radians(75.0))
    """Full field of view of the camera."""
    mask_fov_rad: Span[FieldOfView] | None = None
    """Full field of view that the mask fills; by default the camera's."""
    stripes: Span[Stripes] = (14, 28)
    """The mask's stripes."""
    duty: Span[Duty] = (0.45, 0.55)
    """Bright part of a period of the stripes."""
    phase: Span[Phase] = (0.0, 1.0)
    """Shift of the stripes, in periods."""

    def __post_init__(self) -> None:
        check_ordered(self)


def draw_scope(optics: ScopeOptics, rng: np.random.Generator, ranges: ScopeRanges) -> ScopeOptics:
    """Draw a scope's geometry anew; what has no range keeps its value.

    The number of draws does not depend on the ranges, so that fixing one does not change the others.

    Args:
        optics: The nominal scope. A mask that is an image keeps its pattern, which duty and phase do not affect, and its
            stripe count.
        rng: Source of the draws.
        ranges: What to draw from.
    """
    baseline, fov, mask_fov, duty, phase = rng.uniform(size=5)
    stripes = int(rng.integers(ranges.stripes[0], ranges.stripes[1], endpoint=True))
    camera_fov = _within(ranges.fov_rad, fov)
    mask = replace(
        optics.mask,
        fov_rad=camera_fov if ranges.mask_fov_rad is None else _within(ranges.mask_fov_rad, mask_fov),
        duty=_within(ranges.duty, duty),
        phase=_within(ranges.phase, phase),
        stripes=optics.mask.stripes if optics.mask.is_drawn else stripes,
    )
    return replace(optics, baseline_m=_within(ranges.baseline_m, baseline), fov_rad=camera_fov, mask=mask)


def _within(span: Span[float], fraction: float) -> float:
    """Return the number at a fraction, 0 to 1, of a range."""
    return float(span[0] + fraction * (span[1] - span[0]))
