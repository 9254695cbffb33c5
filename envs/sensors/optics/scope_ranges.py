"""Ranges within which real scopes of this kind differ in their geometry, and scopes drawn from them."""

import math
from dataclasses import dataclass, replace

import numpy as np

from laploop.assets.scope_optics import ScopeOptics
from laploop.envs.sensors.optics.presets import Range
from laploop.errors import InvalidValueError


@dataclass(frozen=True, kw_only=True)
class ScopeRanges:
    """Ranges of channels, field of view and mask, each drawn from evenly, both ends included.

    Channel distances from 3.8 to 5.5 mm are those of 12 mm stereo laparoscopes (4.3 mm in a da Vinci data set, 5 mm in Ellis et
    al., Surg Endosc 2008) with the tolerance of their making; full fields of view from 55 to 75 degrees those of such scopes.
    Stripe counts surround the optimum of 20 that Zuo et al. (J Biomed Opt 30(8):086003, 2025) report. The range of the duty is
    our choice for a mask whose target is 0.5.

    A range of one value, low = high, fixes what it stands for.
    """

    baseline_m: Range = (0.0038, 0.0055)
    fov_rad: Range = (math.radians(55.0), math.radians(75.0))
    """Full field of view of the camera."""
    mask_fov_rad: Range | None = None
    """Full field of view that the mask fills; None makes it that of the camera."""
    stripes: tuple[int, int] = (14, 28)
    duty: Range = (0.45, 0.55)
    phase: Range = (0.0, 1.0)

    def __post_init__(self) -> None:
        """Check every range.

        Raises:
            InvalidValueError: If one is empty or reaches beyond what a scope may have.
        """
        for name, low, high in (
            ("baseline_m", 1e-4, 0.099),
            ("fov_rad", 0.05, 3.0),
            ("mask_fov_rad", 0.05, 3.0),
            ("stripes", 1, 200),
            ("duty", 0.05, 0.95),
            ("phase", -1.0, 1.0),
        ):
            span = getattr(self, name)
            if span is not None and not low <= span[0] <= span[1] <= high:
                raise InvalidValueError(name, span, f"low <= high, both from {low:g} to {high:g}")


def draw_scope(optics: ScopeOptics, rng: np.random.Generator, ranges: ScopeRanges | None = None) -> ScopeOptics:
    """Draw a scope's geometry anew; what has no range stays as it is in `optics`.

    As many numbers are drawn whatever the ranges are, so that fixing one leaves the others' draws alone.

    Args:
        optics: The nominal scope; image size, edge roughness and the like are kept. A mask that is an image keeps its pattern,
            for which duty and phase mean nothing, and its stripe count.
        rng: Source of the draws.
        ranges: What to draw from; the defaults of `ScopeRanges` if None.
    """
    ranges = ranges or ScopeRanges()
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


def _within(span: Range, share: float) -> float:
    """Return the number that lies at a share, 0 to 1, of a range."""
    return float(span[0] + share * (span[1] - span[0]))
