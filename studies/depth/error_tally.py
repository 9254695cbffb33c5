"""Errors of models by truth, set of pixels, group of frames and tissue, and the lines of the table that they become."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from laploop.perception.bootstrap import bounded_ratio
from laploop.perception.metrics import SUMS, DepthErrors, bootstrap_interval
from laploop.studies.depth.table import AGAINST, BOUNDED, DepthRow

SETS = ("every", "valid", "lit")
"""Pixels that count: all, those that the model marks valid, those that the projector reaches."""


@dataclass(frozen=True, kw_only=True)
class FrameGroup:
    """Frames that share lines of the table: all, a bin of working distance, a family, or a texture."""

    working_distance_mm: str = "all"
    family: str = "all"
    texture: str = "all"


class ErrorTally:
    """Adds up errors of all models without keeping the pixels."""

    def __init__(self, groups: Sequence[FrameGroup], tissues: int) -> None:
        """Prepare for groups of frames, which may overlap, and a number of tissues."""
        self._groups = tuple(groups)
        self._tissues = tissues
        self._sums: dict[tuple[str, str], NDArray[np.float64]] = {}
        self._ratios: dict[tuple[str, str], NDArray[np.float64]] = {}
        self._counted: dict[tuple[str, str], NDArray[np.float64]] = {}
        self._frames = np.zeros(len(groups), dtype=np.intp)

    def add_frame(self, places: Sequence[int]) -> None:
        """Count a frame that belongs to some groups."""
        self._frames[list(places)] += 1

    def add(
        self,
        model: str,
        against: str,
        errors: Mapping[str, DepthErrors],
        *,
        ratios: Mapping[str, tuple[float, float]],
        pixels: int,
        places: Sequence[int],
        tissue: int,
    ) -> None:
        """Add one frame's errors of each of `SETS`.

        Args:
            model: Whose errors they are.
            against: One of `AGAINST`.
            errors: By set.
            ratios: The two sums of those of `BOUNDED` that are known.
            pixels: How many count in the frame.
            places: The groups that the frame belongs to.
            tissue: Number of its tissue.
        """
        key = model, against
        sums = self._sums.setdefault(key, np.zeros((len(self._groups), len(SETS), self._tissues, SUMS)))
        counted = self._counted.setdefault(key, np.zeros(len(self._groups)))
        parts = self._ratios.setdefault(key, np.zeros((len(self._groups), len(BOUNDED), self._tissues, 2)))
        for place in places:
            for name, sums_of_ratio in ratios.items():
                parts[place, BOUNDED.index(name), tissue] += sums_of_ratio
            for which, name in enumerate(SETS):
                sums[place, which, tissue] += errors[name].sums
            counted[place] += pixels

    def rows(self, *, seed: int, resamples: int, note: Callable[[str], str]) -> Iterator[DepthRow]:
        """Return the lines: truth by truth, model by model, group by group; `note` gives a remark on a model.

        Every line starts from the same `seed`, so that all models meet the same draws of tissues.
        """
        order = list(AGAINST)
        for model, against in sorted(self._sums, key=lambda key: order.index(key[1])):
            sums, counted = self._sums[model, against], self._counted[model, against]
            for place, group in enumerate(self._groups):
                every, valid, lit = (DepthErrors(sums=part.sum(axis=0)).metrics() for part in sums[place])
                intervals = [bootstrap_interval(part, np.random.default_rng(seed), resamples=resamples) for part in sums[place]]
                ratios = [
                    bounded_ratio(part, np.random.default_rng(seed), resamples=resamples)
                    for part in self._ratios[model, against][place]
                ]
                yield DepthRow(
                    model=model,
                    against=against,
                    working_distance_mm=group.working_distance_mm,
                    family=group.family,
                    texture=group.texture,
                    frames=int(self._frames[place]),
                    valid_fraction=valid.pixels / max(1.0, counted[place]),
                    every=every,
                    every_interval=intervals[0],
                    valid=valid,
                    valid_interval=intervals[1],
                    lit_fraction=lit.pixels / max(1.0, counted[place]),
                    lit=lit,
                    lit_interval=intervals[2],
                    **dict(zip(BOUNDED, ratios, strict=True)),
                    note=note(model),
                )
