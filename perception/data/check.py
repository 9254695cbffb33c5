"""Checks a data set for damage, and for contents that cannot be right."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from laploop.errors import LaploopError
from laploop.perception.data.calibrated_pair_store import CalibratedPairStore
from laploop.perception.data.dataset import SPLITS
from laploop.perception.data.datasets import AnyStore
from laploop.perception.data.imported_pair_store import ImportedPairStore
from laploop.perception.data.pair_store import PairFrame, PairStore

_MEDIAN_LIMIT_MM = 2.0
"""Largest median difference between reference and exact depth of a pair: four times the error allowed of a calibration."""
_SMALLEST_FRACTION = 0.2
"""Of the image that must have a reference depth, and that the projector must reach."""
_SETTLED_MM_S = 0.1


@dataclass(frozen=True, kw_only=True)
class CheckResult:
    """The result of a check."""

    frames: int
    done: int
    problems: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Whether there is no problem."""
        return not self.problems


def check_dataset(store: AnyStore, *, report: Callable[[int], None] | None = None) -> CheckResult:
    """Check every frame of a data set: complete, readable, unchanged, and plausible.

    A frame must be done; its arrays must be those that were written; its depth, lit and shadow masks must agree on where
    something was hit. Of a pair, the reference depth must also follow from the stored cloud and calibration, and lie near the
    exact one. No tissue may be in two splits. `report` is called with the number of frames checked so far.
    """
    done = store.done()
    problems = _check_plan(store)
    for index in range(len(store)):
        found = _check_frame(store, index) if done[index] else ["not done"]
        problems += [f"{store.NOUN} {index}: {what}" for what in found]
        if report is not None:
            report(index + 1)
    return CheckResult(frames=len(store), done=int(done.sum()), problems=tuple(problems))


def _check_plan(store: AnyStore) -> list[str]:
    problems = []
    if not np.isin(store.split, np.arange(len(SPLITS))).all():
        problems.append(f"split: numbers other than 0 to {len(SPLITS) - 1}")
    for tissue in np.unique(store.tissue_seed):
        splits = np.unique(store.split[store.tissue_seed == tissue])
        if len(splits) > 1:
            names = ", ".join(SPLITS[split] if split < len(SPLITS) else str(split) for split in splits)
            problems.append(f"tissue {tissue}: in more than one split ({names})")
    return problems


def _check_frame(store: AnyStore, index: int) -> list[str]:
    try:
        store.verify([index])
        if isinstance(store, ImportedPairStore):
            return _check_imported(store, index)
        if isinstance(store, PairStore):
            return _check_pair(store, index)
        depth_mm, lit = store.depth_mm(index), store.lit(index)
    except LaploopError as error:
        return [str(error)]
    problems = _check_positive("depth_mm", depth_mm)
    if not np.isfinite(depth_mm).any():
        problems.append("nothing was hit")
    if (lit & np.isnan(depth_mm)).any():
        problems.append("lit where nothing was hit")
    return problems


def _check_pair(store: PairStore, index: int) -> list[str]:
    frame, speed = store.frame(index), store.metadata(index).get("surface_speed_mm_s", np.nan)
    problems = _check_reference(store, index, frame.reference_depth_mm)
    if not speed <= _SETTLED_MM_S:
        problems.append(f"the tissue moved at {speed:g} mm/s when it was taken")
    return problems + _check_content(frame)


def _check_imported(store: ImportedPairStore, index: int) -> list[str]:
    image, reference_mm = store.image(index), store.reference_depth_mm(index)
    problems = _check_reference(store, index, reference_mm) + _check_positive("reference_depth_mm", reference_mm)
    if image.min() == image.max():
        problems.append("its image is uniform")
    if (share := float(np.isfinite(reference_mm).mean())) < _SMALLEST_FRACTION:
        problems.append(f"{share:.1%} of the image have a reference depth; expected: at least {_SMALLEST_FRACTION:.0%}")
    return problems


def _check_reference(store: CalibratedPairStore, index: int, reference_mm: NDArray[np.float32]) -> list[str]:
    number = store.metadata(index).get("index")
    reprojected = store.reproject_with(index, store.calibration.scope_from_reference).depth_mm
    problems = []
    if number != index:
        problems.append(f"its metadata belong to pair {number}")
    if not np.array_equal(reference_mm, reprojected, equal_nan=True):
        problems.append("its reference depth is not what the stored cloud and calibration give")
    return problems


def _check_positive(name: str, values: NDArray[np.float32]) -> list[str]:
    return [f"{name} is not positive everywhere"] if np.nanmin(values, initial=np.inf) <= 0.0 else []


def _check_content(frame: PairFrame) -> list[str]:
    seen = np.isfinite(frame.depth_mm)
    problems = [
        f"{name} is not finite exactly where depth_mm is"
        for name in ("projector_x", "projector_y")
        if not np.array_equal(np.isfinite(getattr(frame, name)), seen)
    ]
    if (frame.lit & ~seen).any() or (frame.shadow & ~seen).any() or (frame.lit & frame.shadow).any():
        problems.append("lit and shadow overlap, or lie where nothing was hit")
    if frame.lit.mean() < _SMALLEST_FRACTION:
        problems.append(
            f"the projector reaches {frame.lit.mean():.1%} of the image; expected: at least {_SMALLEST_FRACTION:.0%}"
        )
    if frame.image.min() == frame.image.max():
        problems.append("its image is uniform")
    for name in ("depth_mm", "reference_depth_mm", "reference_z_mm"):
        problems += _check_positive(name, getattr(frame, name))
    both = seen & np.isfinite(frame.reference_depth_mm)
    if both.mean() < _SMALLEST_FRACTION:
        problems.append(f"{both.mean():.1%} of the image have a reference depth; expected: at least {_SMALLEST_FRACTION:.0%}")
    else:
        median = float(np.median(np.abs(frame.reference_depth_mm[both] - frame.depth_mm[both])))
        if not median <= _MEDIAN_LIMIT_MM:
            problems.append(
                f"reference and exact depth differ by {median:.2f} mm in the median; allowed: {_MEDIAN_LIMIT_MM} mm"
            )
    return problems
