"""The card of a collected data set: what is in it, how it was made, and its statistics."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from laploop.perception.calibration.results import transform_residual
from laploop.perception.data.dataset import SPLITS
from laploop.perception.data.pair_store import PairStore

Array = NDArray[np.float64]

_WHAT = """Each pair holds the scope's grey image under its stripes, the depth map and the colour picture of a reference camera
beside it, that depth reprojected into the scope's image (the training target of the paper), and what no bench can measure: the
exact depth, the exact mask coordinates, and where the projector's light arrives. Metadata give the commanded and the reached
pose of the stage, times, optics and seeds. `laploop.perception.PairStore` reads the set."""

_HOW = """`laploop collect` follows the automated program of the paper: the stage moves the deformable phantom to a commanded
position at bounded speed, the program waits until the surface is still, then the scope and the reference camera take their
images. Positions of a tissue are spread evenly over the working range, with any turn, a small tilt and a small shift. Shape,
texture, surfaces, light and noise are drawn anew for each tissue; the light stays the same for all positions of a tissue."""

_LIMITS = """Optics and noise follow the instruments' published numbers where there are any. There is no blood, no smoke, no
dirt on a lens and no motion during an exposure, and one generator makes all phantoms: what works here must still be shown on a
bench."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PairStatistics:
    """Statistics of each pair, (pairs,); differences are reference minus exact depth, over lit pixels that have both."""

    working_distance_mm: Array
    tilt_deg: Array
    settle_s: Array
    valid_share: Array
    """Fraction of the image with a reference depth: the mean of the paper's M."""
    lit_share: Array
    shadow_share: Array
    grey_mean: Array
    saturated_share: Array
    difference_median_mm: Array
    difference_mad_mm: Array
    """Median absolute difference."""
    difference_p95_mm: Array
    """95th percentile of the absolute difference."""


def measure_pairs(store: PairStore) -> PairStatistics:
    """Read every pair of a finished store once."""
    rows = [_measure(store, index) for index in range(len(store))]
    return PairStatistics(**{name: np.array([row[name] for row in rows]) for name in rows[0]})


def summarise(store: PairStore, statistics: PairStatistics) -> dict[str, Any]:
    """Return the data set's statistics as plain data."""
    rotation_deg, translation_mm = transform_residual(store.calibration.scope_from_reference, store.true_scope_from_reference)
    of_split = {name: store.split == number for number, name in enumerate(SPLITS)}
    return {
        "pairs": {name: int(chosen.sum()) for name, chosen in of_split.items()},
        "tissues": store.tissues_by_split(),
        "pairs_with_tool": int(store.tool_in_view.sum()),
        "calibration": {
            "error_px": store.calibration.error_px,
            "true_residual_deg": rotation_deg,
            "true_residual_mm": translation_mm,
        },
        **{name: _spread(values) for name, values in vars(statistics).items()},
    }


def write_card(store: PairStore, summary: dict[str, Any]) -> str:
    """Return the card as Markdown; it shows `examples.png` and `statistics.png` from its own folder."""
    calibration, k = summary["calibration"], store.reference_intrinsics
    lines = [
        "# Data card: stripe frames of a simulated laparoscope with the depth of a reference camera",
        "",
        f"{len(store)} pairs of {sum(summary['tissues'].values())} phantoms, all simulated: no patient, no animal, no person.",
        "",
        "## What is in it",
        "",
        _WHAT,
        "",
        "| split | tissues | pairs |",
        "|---|---:|---:|",
        *[f"| {name} | {summary['tissues'][name]} | {summary['pairs'][name]} |" for name in SPLITS],
        "",
        "No tissue is in two splits.",
        "",
        "## How it was made",
        "",
        _HOW,
        "",
        f"The reference camera's region of interest has {k.width} x {k.height} points.",
        f"The calibration has a reprojection error of {calibration['error_px']:.3f} px. Its transform is off by",
        f"{calibration['true_residual_deg']:.4f} degrees and {calibration['true_residual_mm']:.3f} mm: only a simulator knows.",
        "",
        "## Statistics over the pairs",
        "",
        "| | mean | median | least | largest |",
        "|---|---:|---:|---:|---:|",
        *[_row(field.name, summary[field.name]) for field in fields(PairStatistics)],
        "",
        "Differences are reference minus exact depth, over lit pixels that have both.",
        "",
        "![examples](examples.png)",
        "",
        "![statistics](statistics.png)",
        "",
        "## Limits",
        "",
        _LIMITS,
        "",
    ]
    return "\n".join(lines)


def _measure(store: PairStore, index: int) -> dict[str, float]:
    frame, metadata = store.frame(index), store.metadata(index)
    difference = (frame.reference_depth_mm - frame.depth_mm)[frame.lit]
    difference = difference[np.isfinite(difference)]
    if not len(difference):
        difference = np.array([np.nan])
    return {
        "working_distance_mm": metadata["commanded"]["working_distance_mm"],
        "tilt_deg": metadata["commanded"]["tilt_deg"],
        "settle_s": metadata["settle_s"],
        "valid_share": float(np.isfinite(frame.reference_depth_mm).mean()),
        "lit_share": float(frame.lit.mean()),
        "shadow_share": float(frame.shadow.mean()),
        "grey_mean": float(frame.image.mean()),
        "saturated_share": float((frame.image == np.iinfo(frame.image.dtype).max).mean()),
        "difference_median_mm": float(np.median(difference)),
        "difference_mad_mm": float(np.median(np.abs(difference))),
        "difference_p95_mm": float(np.percentile(np.abs(difference), 95.0)),
    }


def _spread(values: Array) -> dict[str, float]:
    return {
        "mean": float(values.mean()),
        "median": float(np.median(values)),
        "least": float(values.min()),
        "largest": float(values.max()),
    }


def _row(name: str, spread: dict[str, float]) -> str:
    numbers = " | ".join(f"{spread[part]:.3g}" for part in ("mean", "median", "least", "largest"))
    return f"| {name.replace('_', ' ')} | {numbers} |"
