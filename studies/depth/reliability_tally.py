"""How well confidences tell good pixels from bad ones, and how well slips are foreseen, with intervals over scenes."""

from collections import defaultdict
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from laploop.perception.messages import DepthEstimate
from laploop.perception.reliability import ReliabilityErrors, bounded_scores
from laploop.perception.slip_calibration import SlipCalibration, SlipCounts
from laploop.studies.depth.table import COVERAGES, ReliabilityRow


class ReliabilityTally:
    """Adds up errors by confidence; of each scene it keeps 32 kB a model and truth, not the pixels."""

    def __init__(self, families: Sequence[str]) -> None:
        """Prepare for families of shapes that have rows of their own; the scenes of all others count for `all` alone."""
        self._families = tuple(families)
        self._errors: dict[tuple[str, str], dict[tuple[str, int], ReliabilityErrors]] = {}
        self._slips: dict[tuple[str, str], dict[tuple[str, int], SlipCounts]] = {}

    def add(
        self,
        model: str,
        against: str,
        estimate: DepthEstimate,
        truth_mm: NDArray[np.float32],
        mask: NDArray[np.bool_],
        *,
        family: str,
        tissue: int,
    ) -> None:
        """Count one frame's pixels where `mask` holds, of a scene of a family; nothing if the estimate has no confidence.

        Slips are counted wherever there is a truth, for beyond the range of depth everything is one.
        """
        if estimate.confidence is None:
            return
        scenes = self._errors.setdefault((model, against), defaultdict(ReliabilityErrors))
        scenes[family, tissue].add(estimate.confidence, estimate.depth_mm, truth_mm, mask)
        if estimate.slip is not None:
            counts = self._slips.setdefault((model, against), defaultdict(SlipCounts))
            counts[family, tissue].add(estimate.slip, estimate.depth_mm, estimate.valid, truth_mm)

    def rows(self, *, seed: int, resamples: int) -> Iterator[ReliabilityRow]:
        """Return the rows, model by model and truth by truth, `all` before the families.

        Every row starts from the same `seed`, so that all models meet the same draws of scenes.
        """
        for (model, against), scenes in self._errors.items():
            for family in ("all", *self._families):
                chosen = [errors.sums for (own, _), errors in scenes.items() if family in {"all", own}]
                sums = np.array(chosen).reshape(len(chosen), *ReliabilityErrors().sums.shape)
                whole = ReliabilityErrors(sums=sums.sum(axis=0))
                aurc_mm, calibration_error = bounded_scores(sums, np.random.default_rng(seed), resamples=resamples)
                yield ReliabilityRow(
                    model=model,
                    against=against,
                    family=family,
                    aurc_mm=aurc_mm,
                    calibration_error=calibration_error,
                    risk_mm=tuple(whole.risk_mm(COVERAGES).tolist()),
                    tenths=tuple(whole.tenths()),
                    slips=self._slip_calibration(model, against, family, np.random.default_rng(seed), resamples),
                )

    def _slip_calibration(
        self, model: str, against: str, family: str, rng: np.random.Generator, resamples: int
    ) -> SlipCalibration | None:
        counts = self._slips.get((model, against), {})
        chosen = [one.sums for (own, _), one in counts.items() if family in {"all", own}]
        return SlipCalibration.of_groups(np.array(chosen), rng, resamples=resamples) if chosen else None
