"""The last step of a network with a confidence: its odds of being within 1 mm, fitted to frames that trained nothing.

A network on anatomy that it has never seen is more often wrong than on what it learned, and does not know. So no family of the
frames shall be believed too much: what is predicted beyond what is seen weighs tenfold.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from laploop.errors import InvalidValueError
from laploop.perception.data.datasets import DepthDataset, open_dataset
from laploop.perception.inference.models import load_network
from laploop.perception.network_specs import NetworkSpec
from laploop.perception.networks.compact_unet import within_logit
from laploop.perception.networks.phase_front import RigBatch
from laploop.perception.reliability import ReliabilityErrors
from laploop.perception.weights import load_weights, save_weights
from laploop.perception.working_range import WITHIN_MM, WORKING_RANGE_MM

ODDS = "triangulation.odds"
"""Name of the tensor that is fitted."""
_EVERY = 4
"""Of so many rows and columns one is read."""
_GROUPS = 20
"""Equal numbers of a family's pixels, by confidence, whose predicted and seen rates are compared."""
_OVERCONFIDENCE = 10.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Readings:
    """What a network says of pixels in the working range, and whether it is right; each (n,)."""

    log_scale: Tensor
    slip: Tensor
    """Probability of a slip."""
    within: Tensor
    """1 where the depth is within 1 mm, else 0."""
    error_mm: Tensor
    family: NDArray[np.str_]

    def confidence(self, odds: Tensor) -> Tensor:
        """Return the probability of being within 1 mm that these odds give, as the network computes it."""
        return torch.sigmoid(within_logit(odds, self.log_scale)) * (1.0 - self.slip)


def read_frames(
    network: Any, data: DepthDataset, indices: Sequence[int], progress: Callable[[int], None] = lambda _: None
) -> Readings:
    """Run a network in single precision on frames with exact depth; `progress` is called with the number of frames read."""
    rows: list[Tensor] = []
    families: list[NDArray[np.str_]] = []
    for number, index in enumerate(indices, start=1):
        with torch.inference_mode():
            image = torch.from_numpy(data.image(index).astype(np.float32))[None]
            output = network(image, RigBatch.from_rigs([data.rig(index)]))
        every = (slice(1, None, _EVERY), slice(1, None, _EVERY))
        exact = torch.from_numpy(data.depth_mm(index))[every].double()
        counts = (exact >= WORKING_RANGE_MM[0]) & (exact <= WORKING_RANGE_MM[1])
        depth, scale, slip = (part[0][every].double() for part in (output.depth_mm, output.log_scale, output.slip))
        rows.append(torch.stack([scale, slip, (depth - exact).abs()])[:, counts])
        families.append(np.full(int(counts.sum()), data.family(index)))
        progress(number)
    scale, slip, error = torch.cat(rows, dim=1)
    within = (error <= WITHIN_MM).double()
    return Readings(log_scale=scale, slip=slip, within=within, error_mm=error, family=np.concatenate(families))


def fit_odds(readings: Readings, start: Tensor) -> Tensor:
    """Return the odds, (3,), for which no family is believed too much, and little too little.

    Within each family, pixels in the order of their confidence make 20 groups of equal size. The loss is the mean square of the
    difference of predicted and seen rate, tenfold where more is predicted, over groups and families; L-BFGS from `start`.
    """
    places = [torch.from_numpy(np.flatnonzero(readings.family == name)) for name in np.unique(readings.family)]
    places = [place[: len(place) // _GROUPS * _GROUPS] for place in places if len(place) >= _GROUPS]
    odds = start.detach().double().clone().requires_grad_()
    optimizer = torch.optim.LBFGS([odds], lr=0.5, max_iter=200, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        optimizer.zero_grad()
        confidence = readings.confidence(odds)
        parts = []
        for place in places:
            order = place[torch.argsort(confidence.detach()[place], stable=True)]
            predicted, seen = (values[order].view(_GROUPS, -1).mean(dim=1) for values in (confidence, readings.within))
            beyond = predicted - seen
            parts.append((torch.where(beyond > 0.0, _OVERCONFIDENCE, 1.0) * beyond.square()).mean())
        total = 100.0 * torch.stack(parts).mean()
        total.backward()  # type: ignore[no-untyped-call]
        return total

    optimizer.step(loss)  # type: ignore[no-untyped-call]
    return odds.detach().float()


def refit_confidence(
    spec: NetworkSpec, weights: Path | None, dataset: Path, out: Path, progress: Callable[[int], None] = lambda _: None
) -> dict[str, Any]:
    """Write weights, by default the shipped ones, with odds fitted to a data set's validation frames, to `out`.

    Returns:
        The odds before and after, and for both the largest difference of predicted and seen rate in a tenth of the confidence.

    Raises:
        InvalidValueError: If the network has no confidence, or the data set no exact depth or no validation frame.
        MissingFileError: If weights or data set are missing.
        WeightsError: If the weights are damaged or of another network.
        OutputError: If `out` cannot be written.
    """
    path = spec.weights if weights is None else weights
    data = open_dataset(dataset)
    indices = data.indices("val").tolist()
    if not data.has_exact or not indices:
        raise InvalidValueError("validation frames", len(indices), "one or more, with exact depth")
    network = load_network(spec, data.rig(indices[0]), path).eval()
    tensors, notes = load_weights(path, network.config.architecture)
    if ODDS not in tensors:
        raise InvalidValueError("network", spec.name, "one with a confidence: compact or ssle-phase")
    readings = read_frames(network, data, indices, progress)
    before = tensors[ODDS]
    after = fit_odds(readings, before)
    kept = {name: note for name, note in notes.items() if not name.startswith("architecture")}
    save_weights(out, {**tensors, ODDS: after}, network.config.architecture, kept)
    return {
        "frames": len(indices),
        "odds_before": before.tolist(),
        "odds": after.tolist(),
        "largest_difference_before": _largest_difference(readings, before),
        "largest_difference": _largest_difference(readings, after),
    }


def _largest_difference(readings: Readings, odds: Tensor) -> float:
    """Return the largest difference of predicted and seen rate in the tenths of the confidence."""
    errors = ReliabilityErrors()
    error_mm = readings.error_mm.numpy().astype(np.float32)
    confidence = readings.confidence(odds.double()).numpy().astype(np.float32)
    errors.add(confidence, error_mm, np.zeros_like(error_mm), np.ones(error_mm.shape, dtype=bool))
    return max(abs(one.predicted - one.seen) for one in errors.tenths() if one.pixels)
