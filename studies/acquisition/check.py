"""Looks through a collected data set for anything that is not as it should be."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from laploop.errors import LaploopError
from laploop.perception.data.frame_store import SPLITS
from laploop.perception.data.pair_store import PairFrame, PairStore

_MEDIAN_LIMIT_MM = 2.0
"""Largest median difference between reference and exact depth of a pair: four times what a calibration may be off."""
_LEAST_SHARE = 0.2
"""Of the pixels that have a reference depth, and of those that the projector reaches."""
_SETTLED_MM_S = 0.1


@dataclass(frozen=True, kw_only=True)
class CheckResult:
    """What was found."""

    pairs: int
    done: int
    problems: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Whether there is nothing wrong."""
        return not self.problems


def check_pairs(path: Path, *, report: Callable[[int], None] | None = None) -> CheckResult:
    """Check every pair of a store: complete, readable, unchanged, and plausible.

    A pair must be done; its arrays must be those that were hashed when they were written; its exact depth, mask coordinates,
    lit and shadow masks must agree about where something was seen; its reference depth must follow from the stored cloud and
    calibration, and lie near the exact one. No tissue may be in two splits.

    Args:
        path: Of the store.
        report: Is told how many pairs were looked at.

    Raises:
        MissingFileError: If there is no store, or its calibration is missing.
        InvalidValueError: If it is of another format, or its calibration is not valid.
    """
    store = PairStore.open(path)
    done = store.done()
    problems = _check_plan(store)
    for index in range(len(store)):
        if not done[index]:
            problems.append(f"pair {index}: not done")
        else:
            problems += [f"pair {index}: {what}" for what in _check_pair(store, index)]
        if report is not None:
            report(index + 1)
    return CheckResult(pairs=len(store), done=int(done.sum()), problems=tuple(problems))


def _check_plan(store: PairStore) -> list[str]:
    problems = []
    if not np.isin(store.split, np.arange(len(SPLITS))).all():
        problems.append(f"split: numbers other than 0 to {len(SPLITS) - 1}")
    for tissue in np.unique(store.tissue_seed):
        splits = np.unique(store.split[store.tissue_seed == tissue])
        if len(splits) > 1:
            names = ", ".join(SPLITS[split] if split < len(SPLITS) else str(split) for split in splits)
            problems.append(f"tissue {tissue}: in more than one split ({names})")
    return problems


def _check_pair(store: PairStore, index: int) -> list[str]:
    try:
        frame, metadata = store.frame(index), store.metadata(index)
        sha256, number = metadata["sha256"], metadata["index"]
        speed = float(metadata["surface_speed_mm_s"])
        same = np.array_equal(
            frame.reference_depth_mm,
            store.reproject_with(index, store.calibration.scope_from_reference).depth_mm,
            equal_nan=True,
        )
    # A damaged chunk shows as whatever the decompressor or the decoder makes of it.
    except (LaploopError, OSError, RuntimeError, ValueError, KeyError, TypeError) as error:
        return [f"cannot be read ({error})"]
    problems = []
    if number != index:
        problems.append(f"its metadata belong to pair {number}")
    if sha256 != frame.sha256():
        problems.append("its arrays are not those that were written (hash)")
    if not same:
        problems.append("its reference depth is not what the stored cloud and calibration give")
    if not speed <= _SETTLED_MM_S:
        problems.append(f"the tissue moved at {speed:g} mm/s when it was taken")
    return problems + _check_content(frame)


def _check_content(frame: PairFrame) -> list[str]:
    seen = np.isfinite(frame.depth_mm)
    problems = [
        f"{name} is not finite exactly where depth_mm is"
        for name in ("projector_x", "projector_y")
        if not np.array_equal(np.isfinite(getattr(frame, name)), seen)
    ]
    if (frame.lit & ~seen).any() or (frame.shadow & ~seen).any() or (frame.lit & frame.shadow).any():
        problems.append("lit and shadow overlap, or lie where nothing was seen")
    if frame.lit.mean() < _LEAST_SHARE:
        problems.append(f"the projector reaches {frame.lit.mean():.1%} of the image; expected: at least {_LEAST_SHARE:.0%}")
    if frame.image.min() == frame.image.max():
        problems.append("its image is even")
    for name in ("depth_mm", "reference_depth_mm", "reference_z_mm"):
        values = getattr(frame, name)
        if np.nanmin(values, initial=np.inf) <= 0.0:
            problems.append(f"{name} is not positive everywhere")
    both = seen & np.isfinite(frame.reference_depth_mm)
    if both.mean() < _LEAST_SHARE:
        problems.append(f"{both.mean():.1%} of the image have a reference depth; expected: at least {_LEAST_SHARE:.0%}")
    else:
        median = float(np.median(np.abs(frame.reference_depth_mm[both] - frame.depth_mm[both])))
        if not median <= _MEDIAN_LIMIT_MM:
            problems.append(
                f"reference and exact depth differ by {median:.2f} mm in the median; allowed: {_MEDIAN_LIMIT_MM} mm"
            )
    return problems
